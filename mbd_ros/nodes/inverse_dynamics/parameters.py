"""Parameters of the node `inverse_dynamics`."""

from mbd_ros.methods.inverse_dynamics.standing import Nearness
from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.nodes.shell.stream_parameters import STREAM

PARAMETERS = (
    *STREAM,
    Parameter("power", bool, "Publish powers and their balance on ~/power.", False),
    Parameter(
        "stance",
        str,
        "Forces of rigid contacts that no wrench gives: 0, or unknowns with the least efforts.",
        "none",
        choices=("none", "minimum-norm"),
    ),
    Parameter(
        "phase_topic",
        str,
        "Topic of the name of the phase, whose contacts are on the ground; empty for geometry.",
        "",
    ),
    Parameter(
        "stance_gap",
        float,
        "Largest gap of what is on the ground, as a multiple of the size [-].",
        Nearness().gap,
        low=0.0,
        high=1.0,
    ),
    Parameter(
        "stance_speed",
        float,
        "Largest speed of it along the normal, of the root of gravity times size [-].",
        Nearness().speed,
        low=0.0,
        high=100.0,
    ),
)
