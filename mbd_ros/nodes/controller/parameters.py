"""Parameters that both controller nodes have beside the gains of their laws."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.contracts.parts import Actuator
from mbd_ros.core.control.contract import ControlledJoints
from mbd_ros.core.state import Array
from mbd_ros.features.control.chatter import ChatterMeter
from mbd_ros.features.control.reference_generator import ReferenceGenerator
from mbd_ros.nodes.shell.constructor_parameters import of
from mbd_ros.nodes.shell.parameters import Parameter, ParameterError
from mbd_ros.nodes.shell.stream_parameters import PARAMETERS as INVERSE_DYNAMICS
from mbd_ros.nodes.shell.stream_parameters import tunable

_SHARED = (
    *("scene", "allow_code", "cutoff", "velocity_margin", "patience", "max_age", "rewind"),
    *("clock_tolerance", "coupling_tolerance"),
)
_REFERENCE = {name: f"reference_{name}" for name in ("ramp", "ramp_speed", "timeout")}
EACH = " One value, or one a joint."

COMMON = (
    *(parameter for parameter in INVERSE_DYNAMICS if parameter.name in _SHARED),
    Parameter(
        "joints", list[str], "Order of ~/commands; empty: that of the actuators of the scene.", ()
    ),
    Parameter(
        "effort_limit",
        list[float],
        "Largest effort of each joint in the order of the actuators [N·m or N], beside the limits "
        "of description and actuators; empty: these alone.",
        (),
        low=0.0,
    ),
    tunable("effort_rate", 0.0, 0.0, 1e12, "Largest change of an effort [N·m/s]; 0: no limit."),
    tunable(
        "timeout", 0.1, 1e-3, 60.0, "Silence of the joint states until the command goes safe [s]."
    ),
    tunable("safe_ramp", 0.2, 0.0, 60.0, "Time in which control and safe command change [s]."),
    *of(ReferenceGenerator, _REFERENCE, skip=1, read_only=False),
    Parameter(
        "constraints.trajectory",
        list[float],
        "How far a goal of ~/follow_joint_trajectory may be off on its way [rad or m]; 0: any."
        + EACH,
        (0.0,),
        low=0.0,
        read_only=False,
    ),
    Parameter(
        "constraints.goal",
        list[float],
        "How far it may be off at its end [rad or m]; 0: any." + EACH,
        (0.0,),
        low=0.0,
        read_only=False,
    ),
    tunable(
        "constraints.stopped_velocity_tolerance",
        0.01,
        0.0,
        1e6,
        "Velocity below which a goal has stopped at its end [rad/s or m/s]; 0: any.",
    ),
    tunable(
        "constraints.goal_time",
        0.0,
        0.0,
        3600.0,
        "Time after the end within which a goal must be reached [s]; 0: any.",
    ),
    tunable("action_monitor_rate", 20.0, 0.1, 1000.0, "Feedback of a goal [Hz]."),
    tunable(
        "error_limit",
        5.0,
        0.0,
        1e9,
        "Multiple of the error bound of the law beyond which the command goes safe; 0: never.",
    ),
    tunable("failures", 20, 1, 1_000_000, "Failures of the law in a row that deactivate."),
    *of(ChatterMeter, {"cutoff": "chatter_cutoff"}, skip=1),
)


def gains(values: Any) -> tuple[Any, ...]:
    """All gains of the control law, to see whether they changed."""
    return tuple(
        value
        for key, value in values._asdict().items()
        if key.startswith(("gains_", "controller"))
    )


def check_lengths(values: Any, joints: ControlledJoints) -> None:
    """Refuse a list that has neither one value nor one a joint.

    Raises:
        ParameterError: Names the parameter.
    """
    for key, value in values._asdict().items():
        is_list = key.startswith(("gains_", "constraints_")) and isinstance(value, tuple)
        if is_list and len(value) not in (1, len(joints)):
            raise ParameterError(
                f"parameter '{key.replace('_', '.', 1)}' has {len(value)} values; accepted: "
                f"one, or one for each of {', '.join(joints.names)}"
            )


def effort_limits(values: Any, joints: ControlledJoints, actuators: Sequence[Actuator]) -> Array:
    """Effort limits: of the description, the actuators and the parameter, the smallest.

    Raises:
        ParameterError: Not one value a joint.
    """
    given: tuple[float, ...] = values.effort_limit
    limits = np.array([joint.max_effort for joint in joints.joints])
    if actuators:
        limits = np.minimum(limits, np.concatenate([a.limits() for a in actuators]))
    if given and len(given) != len(limits):
        raise ParameterError(
            f"parameter 'effort_limit' has {len(given)} values; accepted: none, or one for "
            f"each of {', '.join(joints.names)}"
        )
    return np.minimum(limits, given) if given else limits
