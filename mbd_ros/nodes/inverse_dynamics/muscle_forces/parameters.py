"""Parameters of the node `muscle_forces`."""

from typing import Any

from mbd_ros.features.muscles.static_optimization import EXPONENTS
from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.nodes.shell.stream_parameters import STREAM

PARAMETERS = (
    *STREAM,
    Parameter(
        "objective",
        str,
        "What the activations make least, as of `mbd-ros muscles`.",
        "activation",
        choices=tuple(EXPONENTS),
    ),
    Parameter(
        "exponent",
        float,
        "Of the activations, from 1 on; 0 for that of the objective.",
        0.0,
        low=0.0,
        high=10.0,
    ),
    Parameter("passive", bool, "Passive force of the fibres takes part.", False),
    Parameter(
        "reserves",
        float,
        "Optimal force of a reserve on every coordinate [N·m, N]; 0 for none.",
        1.0,
        low=0.0,
        high=1.0e9,
    ),
    Parameter(
        "reserve_file",
        str,
        "Reserves from actuators of OpenSim (.xml) in place of these; empty for none.",
        "",
    ),
    Parameter(
        "rise", float, "Fastest rise of an activation [1/s]; 0 for any.", 0.0, low=0.0, high=1.0e9
    ),
    Parameter(
        "fall", float, "Fastest fall of an activation [1/s]; 0 for any.", 0.0, low=0.0, high=1.0e9
    ),
    Parameter(
        "emg_use",
        str,
        "Measured activations on ~/emg: none are heard, activations are near them (track), or not "
        "below them (least).",
        "none",
        choices=("none", "track", "least"),
    ),
    Parameter(
        "emg_weight",
        float,
        "Of the squared distance from measured activations.",
        10.0,
        low=1.0e-9,
        high=1.0e9,
    ),
    Parameter(
        "emg_max_age",
        float,
        "How long measured activations stand [s].",
        0.1,
        low=0.0,
        high=60.0,
    ),
    Parameter(
        "reactions",
        str,
        "Loads of joints to publish: none, on the child in its axes, on the parent in its axes, "
        "or on the child in world axes (ground).",
        "none",
        choices=("none", "child", "parent", "ground"),
    ),
    Parameter("links", list[str], "Links whose joint is asked for; empty for all with mass.", ()),
)


def options(values: Any) -> dict[str, Any]:
    """The section `muscles` of a task file that says the same as parameters.

    Measured activations come on a topic: their use is not in it.
    """
    given: dict[str, Any] = {"objective": values.objective, "passive": values.passive}
    for name in ("exponent", "rise", "fall", "reserves"):
        if getattr(values, name) > 0.0:
            given[name] = getattr(values, name)
    if values.reserve_file:
        given["reserves"] = values.reserve_file
    if values.reactions != "none":
        given |= {"reactions": values.reactions, "links": list(values.links)}
    return given
