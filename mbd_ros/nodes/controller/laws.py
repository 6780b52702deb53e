"""Laws of the controller nodes: gains as parameters, and the law that parameters describe."""

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.core.control.contract import ControlledJoints, Controller
from mbd_ros.errors import DataError, ModelError
from mbd_ros.files.plans import read_plan
from mbd_ros.nodes.controller.parameters import COMMON, EACH
from mbd_ros.nodes.shell.constructor_parameters import parameter
from mbd_ros.nodes.shell.parameters import Parameter, ParameterError
from mbd_ros.scene.schema.arguments import Argument, arguments
from mbd_ros.scene.schema.registry import PARTS, resolve

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
    return (*COMMON, law._replace(takes_code=takes_code), *_of({n: _gains(n) for n in laws}))


def with_law(own: tuple[Parameter, ...], law: str) -> tuple[Parameter, ...]:
    """Parameters of a node for a law that may be of another package.

    Args:
        own: Parameters for the laws of this package. A gain of the other law takes the place of
            one that has the same name.
        law: Value of `controller`.

    Raises:
        MbdError: There is no such law, nobody permitted it, or it is none.
    """
    if law in PARTS["controllers"]:
        return own
    other = {gain.name: gain for gain in _of({law: _gains(law)})}
    return (*(p for p in own if p.name not in other), *other.values())


def build_controller(values: Any, joints: ControlledJoints) -> Controller:
    """The law that the parameters describe.

    Raises:
        ParameterError: Names the gain, what is wrong and what is accepted.
    """
    law = resolve("controllers", values.controller, _WHERE)
    names = list(inspect.signature(law).parameters)[1:]
    given = {name: _unwrapped(getattr(values, f"gains_{name}")) for name in names}
    try:
        for name in law.files:
            given[name] = read_plan(given[name]) if given[name] else None
        controller: Controller = law(joints, **given)
    except (ModelError, DataError) as error:
        raise ParameterError(f"parameters gains of {values.controller}: {error}") from error
    return controller


def _gains(law: str) -> tuple[Argument, ...]:
    """Arguments of a law without the joints.

    Raises:
        MbdError: It is no law; what one must offer.
    """
    found = resolve("controllers", law, _WHERE)
    where = f"{_WHERE}: type '{law}'"
    if not issubclass(found, Controller) or found.effort is Controller.effort:
        contract = f"{Controller.__module__}:Controller"
        raise ParameterError(f"{where} must inherit {contract} and override `effort`")
    first = next(iter(inspect.signature(found).parameters.values()), None)
    if first is None or first.kind not in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD):
        raise ParameterError(f"{where} must take (joints, *, gains), joints as its first argument")
    try:
        return arguments(found, skip=1)
    except ModelError as error:
        raise ParameterError(f"{where}: {error}") from error


def _of(laws: Mapping[str, Sequence[Argument]]) -> list[Parameter]:
    """Gains of laws, each once, with the laws that have it."""
    first = {gain.name: gain for gains in reversed(laws.values()) for gain in gains}
    order = dict.fromkeys(gain.name for gains in laws.values() for gain in gains)
    found = []
    for name in order:
        users = [law for law, gains in laws.items() if name in {gain.name for gain in gains}]
        note = f" Of {', '.join(users)}." if len(laws) > 1 else ""
        each = EACH if first[name].per_joint else ""
        found.append(parameter(first[name], f"gains.{name}", note=note + each, read_only=False))
    return found


def _unwrapped(value: Any) -> Any:
    return value[0] if isinstance(value, tuple) and len(value) == 1 else value
