"""Parameters that nodes share which answer joint states."""

from typing import Any

from mbd_ros.methods.inverse_dynamics.torque_estimator import Tuning
from mbd_ros.nodes.shell.parameters import Parameter, constructor_parameters

TUNING = Tuning._fields
ALLOW_CODE = Parameter(
    "allow_code",
    bool,
    "Import what is named as package.module:Class: code of others runs in this node.",
    False,
    fixed=True,
)


def tunable(name: str, default: float, low: float, high: float, text: str) -> Parameter:
    """A number that may change while the node runs."""
    return Parameter(name, type(default), text, default, low=low, high=high, read_only=False)


STREAM = (
    Parameter("scene", str, "Scene: a file, or the name of an embedded one."),
    ALLOW_CODE,
    *constructor_parameters(Tuning, {name: name for name in TUNING}, read_only=False),
    tunable(
        "timeout", 0.5, 1e-3, 3600.0, "Age of the newest joint state that is reported STALE [s]."
    ),
    tunable(
        "clock_tolerance",
        5.0,
        1e-3,
        1e10,
        "Difference of stamp and node clock from which they count as two clocks [s].",
    ),
    tunable(
        "coupling_tolerance",
        0.05,
        0.0,
        100.0,
        "Distance of a measured dependent joint from its coupling that is reported [rad, m].",
    ),
    tunable(
        "wrench_wait",
        0.01,
        0.0,
        10.0,
        "How long a joint state waits for the wrenches of its stamp [s].",
    ),
    Parameter(
        "wrench_max_age",
        float,
        "How long the newest wrench stands for later joint states [s].",
        0.1,
        low=0.0,
        high=60.0,
    ),
)


def stream_parameters(*names: str) -> tuple[Parameter, ...]:
    """Those of `STREAM` with these names."""
    return tuple(parameter for parameter in STREAM if parameter.name in names)


def tuning(values: Any) -> Tuning:
    """The part of the parameters that tunes the estimator."""
    return Tuning(*(getattr(values, field) for field in TUNING))
