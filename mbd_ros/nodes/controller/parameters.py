"""Parameters of the controller nodes, and the law that they describe."""

import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.control.chatter import DEFAULT_CUTOFF
from mbd_ros.core.control.contract import ControlledJoints, Controller
from mbd_ros.core.parts import Actuator
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.nodes.inverse_dynamics.parameters import PARAMETERS as INVERSE_DYNAMICS
from mbd_ros.nodes.inverse_dynamics.parameters import tunable
from mbd_ros.nodes.shell.parameters import Parameter, ParameterError
from mbd_ros.scene.registry import resolve

_SHARED = (
    *("scene", "allow_code", "cutoff", "velocity_margin", "patience", "max_age", "rewind"),
    *("clock_tolerance", "coupling_tolerance"),
)
_EACH = "; one value, or one a joint"


def _gain(name: str, default: float, text: str) -> Parameter:
    return Parameter(
        f"gains.{name}", list[float], text + _EACH, (default,), low=0.0, read_only=False
    )


_COMMON = (
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
    tunable("reference_ramp", 0.5, 0.0, 60.0, "Shortest time to a reference that jumps [s]."),
    tunable(
        "reference_ramp_speed", 0.5, 1e-3, 1.0, "Share of the velocity limits for such ramps."
    ),
    tunable(
        "reference_timeout", 0.5, 1e-3, 60.0, "Age of a ~/reference from which it is held [s]."
    ),
    Parameter(
        "constraints.trajectory",
        list[float],
        "How far a goal of ~/follow_joint_trajectory may be off on its way [rad or m]; 0: any"
        + _EACH,
        (0.0,),
        low=0.0,
        read_only=False,
    ),
    Parameter(
        "constraints.goal",
        list[float],
        "How far it may be off at its end [rad or m]; 0: any" + _EACH,
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
    Parameter(
        "chatter_cutoff",
        float,
        "Frequency from which motion of a command counts as chatter [Hz].",
        DEFAULT_CUTOFF,
        low=1e-3,
        high=1e6,
    ),
)

SLIDING_MODE = (
    *_COMMON,
    Parameter(
        "controller",
        str,
        "The law.",
        "sliding_mode",
        choices=("sliding_mode", "super_twisting", "computed_torque", "gravity_compensation"),
    ),
    _gain("bandwidth", 20.0, "lambda of s = e' + lambda e [1/s]: sliding_mode, super_twisting"),
    _gain("gain", 60.0, "Reaching gain [rad/s^2 or m/s^2]: sliding_mode"),
    _gain(
        "boundary_layer",
        0.5,
        "Width of the boundary layer, at least gain x period [rad/s or m/s]: sliding_mode",
    ),
    Parameter(
        "gains.law",
        str,
        "Reaching law: sliding_mode.",
        "constant",
        choices=("constant", "exponential", "power_rate"),
        read_only=False,
    ),
    _gain("rate", 10.0, "Rate of the exponential law [1/s]: sliding_mode"),
    tunable("gains.power", 0.5, 1e-6, 0.999999, "Exponent of the power-rate law: sliding_mode."),
    _gain(
        "disturbance_rate",
        200.0,
        "Bound of the rate of disturbing accelerations [rad/s^3 or m/s^3]: super_twisting",
    ),
    _gain("proportional", 3.0, "Factor of k1 [-]: super_twisting"),
    _gain("integral", 2.5, "Factor of k2 [-], > 1: super_twisting"),
    _gain("kp", 400.0, "Acceleration per error [1/s^2]: computed_torque"),
    _gain("kd", 40.0, "Acceleration per velocity error [1/s]: computed_torque"),
    _gain("stiffness", 50.0, "Torque per error [N·m/rad or N/m]: gravity_compensation"),
    _gain("damping", 5.0, "Torque per velocity error [N·m·s/rad]: gravity_compensation"),
)

QP = (
    *_COMMON,
    Parameter("controller", str, "The law.", "qp_tracking", choices=("qp_tracking",)),
    _gain("kp", 100.0, "Acceleration per error [1/s^2]"),
    _gain("kd", 20.0, "Acceleration per velocity error [1/s]"),
    _gain("weight", 1.0, "Cost of a squared acceleration error"),
    tunable(
        "gains.horizon", 0.02, 1e-6, 10.0, "Time ahead for which limits of motion are kept [s]."
    ),
    tunable("gains.braking", 0.2, 1e-6, 10.0, "Time from the largest velocity to rest [s]."),
    tunable("gains.position_margin", 0.0, 0.0, 10.0, "Distance to position limits [rad or m]."),
    *(
        Parameter(
            f"gains.{which}_limits",
            bool,
            f"Keep the {which} limits of the robot description.",
            True,
            read_only=False,
        )
        for which in ("position", "velocity")
    ),
)


def gains(values: Any) -> tuple[Any, ...]:
    """Everything that the law is made of, to see whether it changed."""
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


def build_controller(values: Any, joints: ControlledJoints) -> Controller:
    """The law that the parameters describe.

    Raises:
        ParameterError: Names the gain, what is wrong and what is accepted.
    """
    law = resolve("controllers", values.controller, "parameter 'controller'")
    names = list(inspect.signature(law).parameters)[1:]
    given = {name: _unwrapped(getattr(values, f"gains_{name}")) for name in names}
    try:
        controller: Controller = law(joints, **given)
    except ModelError as error:
        raise ParameterError(f"parameters gains of {values.controller}: {error}") from error
    return controller


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


def _unwrapped(value: Any) -> Any:
    return value[0] if isinstance(value, tuple) and len(value) == 1 else value
