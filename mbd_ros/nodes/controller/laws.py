"""Laws of the controller nodes: gains as parameters, and the law that parameters describe."""

from collections.abc import Sequence
from typing import Any

from mbd_ros.core.control.contract import ControlledJoints, Controller
from mbd_ros.errors import ModelError
from mbd_ros.nodes.controller.parameters import COMMON, EACH
from mbd_ros.nodes.shell.constructor_parameters import parameter
from mbd_ros.nodes.shell.parameters import Parameter, ParameterError
from mbd_ros.scene.arguments import Argument, arguments
from mbd_ros.scene.registry import PARTS, resolve

OF_QP = ("qp_tracking",)
OTHERS = tuple(name for name in PARTS["controllers"] if name not in OF_QP)
_WHERE = "parameter 'controller'"


def parameters(laws: Sequence[str], chosen: str) -> tuple[Parameter, ...]:
    """All parameters of a node that offers some laws.

    Args:
        laws: Names in the registry.
        chosen: The law that `controller` names by default. What two laws call by one name has
            default, range and text of this one, or of the first that has it.
    """
    own = {law: {gain.name: gain for gain in _gains(law)} for law in laws}
    names = dict.fromkeys(name for gains in own.values() for name in gains)
    law = Parameter("controller", str, "The control law.", chosen, choices=tuple(laws))
    return (*COMMON, law, *(_parameter(name, own, chosen) for name in names))


def build_controller(values: Any, joints: ControlledJoints) -> Controller:
    """The law that the parameters describe.

    Raises:
        ParameterError: Names the gain, what is wrong and what is accepted.
    """
    law = resolve("controllers", values.controller, _WHERE)
    names = [gain.name for gain in arguments(law, skip=1)]
    given = {name: _unwrapped(getattr(values, f"gains_{name}")) for name in names}
    try:
        controller: Controller = law(joints, **given)
    except ModelError as error:
        raise ParameterError(f"parameters gains of {values.controller}: {error}") from error
    return controller


def _gains(law: str) -> tuple[Argument, ...]:
    return arguments(resolve("controllers", law, _WHERE), skip=1)


def _parameter(name: str, own: dict[str, dict[str, Argument]], chosen: str) -> Parameter:
    """A gain, with the laws that have it."""
    users = [law for law, gains in own.items() if name in gains]
    gain = own[chosen if chosen in users else users[0]][name]
    note = f" Of {', '.join(users)}." if len(own) > 1 else ""
    each = EACH if gain.per_joint else ""
    return parameter(gain, f"gains.{name}", note=note + each, read_only=False)


def _unwrapped(value: Any) -> Any:
    return value[0] if isinstance(value, tuple) and len(value) == 1 else value
