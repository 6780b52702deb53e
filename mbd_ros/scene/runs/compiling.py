"""Simulations whose steps are compiled, where a scene asks for them."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.projection.assembly import assemble
from mbd_ros.core.projection.stabilization import Stabilization
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SolveError, install_hint

if TYPE_CHECKING:
    from mbd_ros.compiled.runs.compiled_method import CompiledMethod
    from mbd_ros.compiled.runs.implicit_method import ImplicitMethod

T = TypeVar("T")
Tell = Callable[[str], None]
_KEPT: WeakKeyDictionary[Any, dict[Any, dict[Any, Any]]] = WeakKeyDictionary()


def _silent(line: str) -> None:
    """Nobody is told."""


def kept_for(scene: Any, key: Any) -> dict[Any, Any]:
    """What is kept while a scene lives, for systems of one key that differ in nothing else."""
    return _KEPT.setdefault(scene, {}).setdefault(key, {})


def compiled_simulation(
    system: System,
    method: Integrator,
    correction: Stabilization,
    dt: float,
    *,
    start: State,
    is_demanded: bool,
    tell: Tell | None = None,
    kept: dict[Any, Any] | None = None,
) -> Simulation:
    """A simulation in compiled steps, or in plain ones where none are demanded and none can be.

    Args:
        system: As for `Simulation`.
        method: As for `Simulation`.
        correction: As for `Simulation`.
        dt: As for `Simulation` [s].
        start: Where simulations usually begin, a state of all joints.
        is_demanded: Whether plain steps are refused.
        tell: Is told what takes time.
        kept: As for `CompiledMethod`.

    Raises:
        ModelError: Compiled steps are demanded and cannot be: says what keeps the scene from
            them. Or the method does not serve the system.
    """
    try:
        if not is_demanded and (why := _dependence(system, start)):
            raise Impossible(why)
        simulation = _compiled(system, method, correction, dt, (tell or _silent, kept))
    except Impossible as error:
        if is_demanded:
            raise ModelError(
                f"solver compiled: {_dependence(system, start) or error}; accepted here: auto, "
                "which takes plain steps then, or plain"
            ) from error
        simulation = Simulation(system, method, correction, dt)
        simulation.how = f"not compiled: {error}"
    return simulation


class Impossible(ModelError):
    """Why there are no compiled steps."""


def _dependence(system: System, start: State) -> str:
    """How many rows are independent at the start, where not all are.

    Compiled steps would be handed over, all of them.
    """
    rows = len(system.held.rows)
    if not rows:
        return ""
    try:
        y = assemble(system, system.reduce(start))
        rank = system.held.factor_at(y.t, y.q).rank
    except SolveError:  # the start itself says it, if it is this one
        return ""
    return f"{rank} of {rows} rows are independent, plain steps solve by rank" * (rank < rows)


def _compiled(
    system: System,
    method: Integrator,
    correction: Stabilization,
    dt: float,
    more: tuple[Tell, dict[Any, Any] | None],
) -> Simulation:
    """A simulation in compiled steps.

    Raises:
        Impossible: Says why there are none.
    """

    def take() -> "tuple[CompiledMethod | ImplicitMethod, Simulation]":
        from mbd_ros.compiled.runs.compiled_method import CompiledMethod
        from mbd_ros.compiled.runs.implicit_method import ImplicitMethod

        method_of: Callable[..., Any] = ImplicitMethod if method.asks else CompiledMethod
        steps: CompiledMethod | ImplicitMethod = method_of(method, correction, *more)
        steps.refuse(system)  # in these words, before anything else speaks of the method
        return steps, Simulation(system, steps, correction, dt)

    steps, simulation = attempted(take)
    simulation.how = _described(steps)
    return simulation


def attempted(take: Callable[[], T]) -> T:
    """What a function compiles.

    Raises:
        Impossible: Says why there is nothing.
    """
    try:
        from mbd_ros.compiled.build.compiler import BuildError
        from mbd_ros.compiled.symbols.untraceable import Untraceable
    except ModuleNotFoundError as error:
        raise _lacking(error) from error
    try:
        return take()
    except ModuleNotFoundError as error:
        raise _lacking(error) from error
    except (Untraceable, BuildError) as error:
        raise Impossible(str(error)) from error


def _lacking(error: ModuleNotFoundError) -> Exception:
    hint = install_hint(str(error.name))
    return Impossible(hint) if hint else error


def _described(steps: "CompiledMethod | ImplicitMethod") -> str:
    """What was compiled, and how long that took."""
    library: Any = steps.library
    count = sum(library.source.operations.values())
    return f"compiled: {count} operations by {library.compiler} in {library.seconds:.1f} s"
