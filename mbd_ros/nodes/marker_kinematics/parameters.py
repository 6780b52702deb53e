"""Parameters of the node `marker_kinematics`."""

from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.nodes.shell.stream_parameters import stream_parameters, tunable

PARAMETERS = (
    *stream_parameters("scene", "allow_code", "cutoff", "rewind", "clock_tolerance"),
    Parameter(
        "task",
        str,
        "Task file with weights of markers and coordinates, or a set-up of OpenSim's inverse "
        "kinematics; empty for the weights of the scene.",
        "",
    ),
    Parameter("limits", bool, "Whether joints keep their position limits.", True),
    tunable("timeout", 0.5, 1e-3, 3600.0, "Age of the newest markers that is reported STALE [s]."),
    tunable(
        "residual_tolerance",
        0.1,
        0.0,
        100.0,
        "Root mean square distance of the markers that is reported [m].",
    ),
    Parameter(
        "failures",
        int,
        "Messages in a row without a fit after which the node deactivates.",
        1000,
        low=1,
        high=1_000_000,
        read_only=False,
    ),
)
