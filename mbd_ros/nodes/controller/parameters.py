"""Parameters of the controller nodes, gains of their laws among them."""

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.contracts import Actuator
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.control.loop_watch import ChatterMeter
from mbd_ros.features.control.reference import ReferenceGenerator
from mbd_ros.files.plan import read_plan
from mbd_ros.methods.control.contract import ControlledJoints, Controller
from mbd_ros.nodes.shell.parameters import (
    TUNING,
    Parameter,
    ParameterError,
    argument_parameter,
    constructor_parameters,
    stream_parameters,
    tunable,
)
from mbd_ros.scene.schema.registry import PARTS, resolve
from mbd_ros.scene.schema.schema import Argument, arguments

_REFERENCE = {name: f"reference_{name}" for name in ("ramp", "ramp_speed", "timeout")}
EACH = " One value, or one a joint."
COMMON = (
    *stream_parameters(
        "scene",
        "allow_code",
        *TUNING,
        "clock_tolerance",
        "coupling_tolerance",
    ),
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
    *constructor_parameters(ReferenceGenerator, _REFERENCE, skip=1, read_only=False),
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
    *constructor_parameters(ChatterMeter, {"cutoff": "chatter_cutoff"}, skip=1),
)
OF_QP = ("qp_tracking",)
OTHERS = tuple(name for name in PARTS["controllers"] if name not in OF_QP)
_WHERE = "parameter 'controller'"


def parameters(laws: Sequence[str], chosen: str, takes_code: bool) -> tuple[Parameter, ...]:
    """All parameters of a node that offers some laws.

    Args:
        laws: Names in the registry. What two laws call by one name is one parameter, and has the
            default and the range of the first of them.
        chosen: The law that `controller` names by default.
        takes_code: Whether `controller` may name a law of another package.
    """
    law = Parameter("controller", str, "The control law.", chosen, choices=tuple(laws))
    return (
        *COMMON,
        law._replace(takes_code=takes_code),
        *_gain_parameters({n: _gains_of_law(n) for n in laws}),
    )


def _gain_parameters(laws: Mapping[str, Sequence[Argument]]) -> list[Parameter]:
    """Gains of laws, each once, with the laws that have it."""
    first = {gain.name: gain for gains in reversed(laws.values()) for gain in gains}
    order = dict.fromkeys(gain.name for gains in laws.values() for gain in gains)
    parameters = []
    for name in order:
        users = [law for law, gains in laws.items() if name in {gain.name for gain in gains}]
        note = f" Of {', '.join(users)}." if len(laws) > 1 else ""
        each = EACH if first[name].per_joint else ""
        parameters.append(
            argument_parameter(first[name], f"gains.{name}", note=note + each, read_only=False)
        )
    return parameters


def _gains_of_law(law: str) -> tuple[Argument, ...]:
    """Arguments of a law without the joints.

    Raises:
        MbdError: It is no law; what one must offer.
    """
    law_class = resolve("controllers", law, _WHERE)
    where = f"{_WHERE}: type '{law}'"
    if not issubclass(law_class, Controller) or law_class.effort is Controller.effort:
        contract = f"{Controller.__module__}:Controller"
        raise ParameterError(f"{where} must inherit {contract} and override `effort`")
    first = next(iter(inspect.signature(law_class).parameters.values()), None)
    if first is None or first.kind not in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD):
        raise ParameterError(f"{where} must take (joints, *, gains), joints as its first argument")
    try:
        return arguments(law_class, skip=1)
    except ModelError as error:
        raise ParameterError(f"{where}: {error}") from error


def with_law(parameters: tuple[Parameter, ...], law: str) -> tuple[Parameter, ...]:
    """Parameters of a node for a law that may be of another package.

    Args:
        parameters: Parameters for the laws of this package. A gain of the other law replaces one
            of the same name.
        law: Value of `controller`.

    Raises:
        MbdError: There is no such law, nobody permitted it, or it is none.
    """
    if law in PARTS["controllers"]:
        return parameters
    other = {gain.name: gain for gain in _gain_parameters({law: _gains_of_law(law)})}
    return (*(p for p in parameters if p.name not in other), *other.values())


def build_controller(values: Any, joints: ControlledJoints) -> Controller:
    """The law that the parameters describe.

    Raises:
        ParameterError: Names the gain, what is wrong and what is accepted.
    """
    law = resolve("controllers", values.controller, _WHERE)
    names = list(inspect.signature(law).parameters)[1:]
    gains = {name: _unwrapped(getattr(values, f"gains_{name}")) for name in names}
    try:
        for name in law.files:
            gains[name] = read_plan(gains[name]) if gains[name] else None
        controller: Controller = law(joints, **gains)
    except (ModelError, DataError) as error:
        raise ParameterError(f"parameters gains of {values.controller}: {error}") from error
    return controller


def _unwrapped(value: Any) -> Any:
    return value[0] if isinstance(value, tuple) and len(value) == 1 else value


def effort_limits(values: Any, joints: ControlledJoints, actuators: Sequence[Actuator]) -> Array:
    """Effort limits: of the description, the actuators and the parameter, the smallest.

    Raises:
        ParameterError: Not one value a joint.
    """
    chosen: tuple[float, ...] = values.effort_limit
    limits = np.array([joint.max_effort for joint in joints.joints])
    if actuators:
        limits = np.minimum(limits, np.concatenate([a.limits() for a in actuators]))
    if chosen and len(chosen) != len(limits):
        raise ParameterError(
            f"parameter 'effort_limit' has {len(chosen)} values; accepted: none, or one for "
            f"each of {', '.join(joints.names)}"
        )
    return np.minimum(limits, chosen) if chosen else limits


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


def gains(values: Any) -> tuple[Any, ...]:
    """All gains of the control law, to see whether they changed."""
    return tuple(
        value
        for key, value in values._asdict().items()
        if key.startswith(("gains_", "controller"))
    )
