"""Simulations and systems that are compiled, where a scene asks for them.

Steps, functions of a scene with numbers of its parts as arguments, and a system with exact
derivatives are traced and compiled by `compiled`; what cannot be is taken in plain steps, unless
the scene demands compiled ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from mbd_ros.core.contracts import Part, Slots
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Mode, State
from mbd_ros.errors import ModelError, SceneError, SolveError, install_hint
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.projection.assembly import Stabilization, assemble
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.building import Site, named_entry
from mbd_ros.scene.reading.part_entries import part_of
from mbd_ros.scene.schema.sections import parts_in
from mbd_ros.scene.variants import Place, found_place, places_of, set_value, with_numbers

if TYPE_CHECKING:
    from mbd_ros.compiled.runs.compiled_method import CompiledMethod
    from mbd_ros.compiled.runs.compiled_system import CompiledSystem
    from mbd_ros.compiled.runs.implicit_method import ImplicitMethod
    from mbd_ros.compiled.symbols.trace import Traced

T = TypeVar("T")
Tell = Callable[[str], None]
_OF_LINKS = ("mass", "com", "inertia")  # numbers that are no arguments of a part
_CACHES: WeakKeyDictionary[Any, dict[Any, dict[Any, Any]]] = WeakKeyDictionary()


def compiled_simulation(
    system: System,
    method: Integrator,
    correction: Stabilization,
    dt: float,
    *,
    start: State,
    is_demanded: bool,
    tell: Tell | None = None,
    cache: dict[Any, Any] | None = None,
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
        cache: Compiled code of earlier runs, see `cache_of`.

    Raises:
        ModelError: Compiled steps are demanded and cannot be: says what keeps the scene from
            them. Or the method does not serve the system.
    """
    try:
        if not is_demanded and (why := _dependence(system, start)):
            raise Impossible(why)
        simulation = _compiled(system, method, correction, dt, (tell or silent, cache))
    except Impossible as error:
        if is_demanded:
            raise ModelError(
                f"solver compiled: {_dependence(system, start) or error}; accepted here: auto, "
                "which takes plain steps then, or plain"
            ) from error
        simulation = Simulation(system, method, correction, dt)
        simulation.how = f"not compiled: {error}"
    return simulation


def _dependence(system: System, start: State) -> str:
    """How many rows are independent at the start, where not all are.

    Compiled steps would be handed over, all of them.
    """
    rows = len(system.bilateral.rows)
    if not rows:
        return ""
    try:
        y = assemble(system, system.reduce(start))
        rank = system.bilateral.factor_at(y.t, y.q).rank
    except SolveError:  # the start itself says it, if it is this one
        return ""
    return f"{rank} of {rows} rows are independent, plain steps solve by rank" * (rank < rows)


class Impossible(ModelError):
    """Why there are no compiled steps."""


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

    def take() -> tuple[CompiledMethod | ImplicitMethod, Simulation]:
        from mbd_ros.compiled.runs.compiled_method import CompiledMethod
        from mbd_ros.compiled.runs.implicit_method import ImplicitMethod

        method_of: Callable[..., Any] = (
            ImplicitMethod if method.compiled_functions else CompiledMethod
        )
        steps: CompiledMethod | ImplicitMethod = method_of(method, correction, *more)
        steps.refuse(system)  # in these words, before anything else speaks of the method
        return steps, Simulation(system, steps, correction, dt)

    steps, simulation = attempted(take)
    simulation.how = _described(steps)
    return simulation


def attempted(take: Callable[[], T]) -> T:
    """Return the result of a function that compiles.

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


def _described(steps: CompiledMethod | ImplicitMethod) -> str:
    """Return a sentence on the compiled steps and the time it took."""
    library: Any = steps.library
    count = sum(library.source.operations.values())
    return f"compiled: {count} operations by {library.compiler} in {library.seconds:.1f} s"


def silent(line: str) -> None:
    """Nobody is told."""


def cache_of(scene: Any, key: Any) -> dict[Any, Any]:
    """Return the cache of compiled code that lives as long as the scene."""
    return _CACHES.setdefault(scene, {}).setdefault(key, {})


def traced(
    scene: Scene,
    system: System | None = None,
    parameters: Sequence[str] = (),
    mode: Mode = (),
) -> Traced:
    """The functions of a scene, with numbers of its parts as arguments.

    Args:
        system: One that it made; a new one by default.
        parameters: `<name of a part>.<argument>`, as `with_numbers` takes them: p, in this order.
        mode: Of rows that give way at events.

    Raises:
        Untraceable: Names the part and why.
        SceneError: Names a parameter that no part has.
    """
    from mbd_ros.compiled.symbols.trace import trace

    made = partial(parts_of_symbols, scene)
    return trace(scene.system() if system is None else system, parameters, mode, made)


def parts_of_symbols(scene: Scene, symbols: Mapping[str, Any]) -> dict[str, Part]:
    """The parts of which numbers are replaced, by name; those of the scene stay.

    Args:
        symbols: Symbols by `<name of a part>.<argument>`.

    Raises:
        SceneError: Names a parameter that no part has.
    """
    origin, places = scene.origin.changed(), places_of(scene)
    entries, changed = dict(scene.entries), dict[Place, str]()
    for key, symbol in symbols.items():
        link, _, number = key.rpartition(".")
        if link in scene.robot.inertias() and number in _OF_LINKS:
            raise SceneError(
                f"{origin.name}: {key} is no number of a part; accepted: numbers of parts, such "
                "as <spring>.stiffness, or values of it one after the other (continuation)"
            )
        place, path = found_place(origin, places, key)
        set_value(entries, place, path, symbol)
        changed.setdefault(place, key)
    sections = {section.key: section for section in scene.sections}
    traced_parts: dict[str, Part] = {}
    for place, key in changed.items():
        section = sections[place.section]
        if not section.has_types or place.at is None:
            raise SceneError(f"{origin.name}: {key} is no number of a part")
        built = scene.parts[place.section]
        names = built if isinstance(built, Mapping) else range(len(built))
        old = dict(zip(names, parts_in(section, built), strict=True))[place.at]
        site = Site(section, origin, scene.robot, scene.parts)
        entry = named_entry(entries[place.section][place.at], f"{site.where}.{old.name}")
        part = part_of(section, entry.value, entry.where, site)
        part.name = old.name
        part.bind(Slots(old.u, old.z))
        traced_parts[old.name] = part
    return traced_parts


def compiled_system(
    scene: Scene,
    parameters: Mapping[str, float] | None = None,
    *,
    solver: Mapping[str, str] | None = None,
    tell: Tell = silent,
) -> CompiledSystem:
    """The system of a scene with exact `derivatives`, in native code.

    Those by parameters are in the order in which they are given.

    Args:
        parameters: Values by name, as `with_numbers` takes them.
        solver: Entry that replaces that of the scene; of it, the tier counts.
        tell: Is told what takes time.

    Raises:
        ModelError: It cannot be compiled; says why.
        SceneError: Names a parameter that no part has.
    """
    numbers = dict(parameters or {})
    changed = with_numbers(scene, numbers) if numbers else scene
    system = changed.system((), solver)

    def take() -> CompiledSystem:
        from mbd_ros.compiled.runs import implicit_method

        implicit_method.refuse_bounds(system)
        form, p = traced(changed, system, list(numbers)), np.array(list(numbers.values()))
        return implicit_method.compiled_system(system, form, p, tell)

    return attempted(take)
