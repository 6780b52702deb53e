"""Simulations of a scene: its equations, an integrator, a stabilization and a step.

Sections that a scene leaves out are chosen here: steps of Dormand and Prince, adaptive ones beside
elastic tendons, whose fibres are stiff, and time stepping where gaps are not smooth, so that no
events can be found; and projection where there are constraints.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.loads.inputs import Source
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import NO_SOURCES, Scene
from mbd_ros.scene.reading.part_entries import build_part

DEFAULT_STABLE = 1.3  # `stable` of the default integrator, known without importing it
DEFAULT_INTEGRATOR = {"type": "dopri5"}
_TIME_STEPPING = {"type": "moreau_jean"}
_ADAPTIVE = {"type": "dopri5", "tolerance": 1.0e-8}
Tell = Callable[[str], None]


def build_simulation(
    scene: Scene,
    *,
    integrator: Mapping[str, Any] | None = None,
    dt: float | None = None,
    stabilization: Mapping[str, Any] | None = None,
    solver: Mapping[str, str] | None = None,
    forces: Sequence[Load] = (),
    sources: Mapping[str, Source] = NO_SOURCES,
    tell: Tell | None = None,
) -> Simulation:
    """A simulation with its own Pinocchio data.

    Args:
        integrator: Entry that replaces that of the scene.
        dt: Step that replaces that of the scene [s].
        stabilization: Entry that replaces that of the scene.
        solver: Entry that replaces that of the scene.
        forces: Force terms besides those of the scene.
        sources: What gives the inputs of parts, by name of the part.
        tell: Is told what takes time while steps are compiled.

    Raises:
        SceneError: Names file and key.
    """
    system: System
    if scene.phases:
        from mbd_ros.scene.phased_systems import build_phased_system

        system = build_phased_system(scene, forces, solver, sources)
    else:
        system = scene.system(forces, solver, sources)
    if integrator is None:
        method = integrator_of(scene)
    else:
        method = build_part("integrators", integrator, f"{scene.name}: integrator")
    correction = scene.stabilization
    if stabilization is not None or correction is None:
        has_rows = bool(scene.phases) or bool(system.bilateral.rows)
        entry = stabilization or {"type": "projection" if has_rows else "none"}
        correction = build_part("stabilization", entry, f"{scene.name}: stabilization")
    try:
        parts = system, method, correction, scene.dt if dt is None else dt
        chosen = scene.chosen_solver(solver)
        if scene.phases and chosen.must_compile:
            raise ModelError("solver: compiled does not serve phases; accepted: plain, auto")
        if scene.phases or not chosen.compiles:
            simulation = Simulation(*parts)
            if chosen.compiles:
                simulation.how = "not compiled: phases change what holds"
            return simulation
        from mbd_ros.scene.runs.compiling import cache_of, compiled_simulation

        cache = None if forces else cache_of(scene, chosen.backend)
        wish = {"start": scene.initial, "is_demanded": chosen.must_compile}
        return compiled_simulation(*parts, tell=tell, cache=cache, **wish)
    except ModelError as error:
        raise SceneError(f"{scene.name}: {error}") from error


def integrator_of(scene: Scene) -> Integrator:
    """The integrator of the file, or that of `default_integrator`."""
    if scene.integrator is not None:
        return scene.integrator
    method: Integrator = build_part("integrators", default_integrator(scene), scene.name)
    return method


def default_integrator(scene: Scene) -> Mapping[str, Any]:
    """Entry of the integrator where the file names none."""
    pairs = (part.pair for part in scene.constraints if part.pair is not None)
    if not all(pair.is_smooth for pair in pairs):
        return _TIME_STEPPING
    return _ADAPTIVE if any(part.is_elastic for part in scene.muscles) else DEFAULT_INTEGRATOR
