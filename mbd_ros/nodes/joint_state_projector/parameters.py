"""Parameters of the node `joint_state_projector`."""

from mbd_ros.methods.projection.state_projection import StateProjector
from mbd_ros.nodes.shell.parameters import Parameter, constructor_parameters
from mbd_ros.nodes.shell.stream_parameters import TUNING, stream_parameters

PARAMETERS = (
    *stream_parameters(
        "scene",
        "allow_code",
        *TUNING,
        "timeout",
        "clock_tolerance",
    ),
    *constructor_parameters(
        StateProjector, {"limits": "limits", "amplification": "amplification"}, skip=1
    ),
    Parameter(
        "violation_tolerance",
        float,
        "Violation of a constraint or limit by the measurement that is reported [rad, m].",
        0.05,
        low=0.0,
        high=100.0,
        read_only=False,
    ),
    Parameter(
        "failures",
        int,
        "Joint states in a row without a consistent state near them after which the node "
        "deactivates.",
        1000,
        low=1,
        high=1_000_000,
        read_only=False,
    ),
)
