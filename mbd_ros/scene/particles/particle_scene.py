"""A scene of particles: points and rows between them, no robot."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mbd_ros.core.state import State
from mbd_ros.errors import MbdError, ModelError, SceneError
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.particles.molecules import Molecules
from mbd_ros.methods.particles.pairs import Pairs
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.units import Units
from mbd_ros.methods.particles.verlet_steps import KindSteps, ParticleVerlet
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.particles.particles_entry import Particles, Record
from mbd_ros.scene.reading.building import build, present, refuse_unknown
from mbd_ros.scene.reading.part_entries import build_part
from mbd_ros.scene.schema.sections import PARTICLES, keys

METHODS = ("rattle", "shake")


@dataclass(frozen=True, eq=False, repr=False)
class ParticleScene:
    """A built scene of particles, in units of its own.

    Attributes:
        origin: The file, or what else its sections came from.
        parts: The built sections, by key.
        entries: The sections as given, by key.
    """

    origin: Origin
    parts: Mapping[str, Any]
    entries: Mapping[str, Any]

    @property
    def path(self) -> Path | None:
        """The file; None for a scene that Python made."""
        return self.origin.path

    @property
    def name(self) -> str:
        """The file as messages call it, `scene` without one."""
        return self.origin.name

    @property
    def units(self) -> Units:
        """Units of all its numbers."""
        units: Units = self.parts["units"]
        return units

    @property
    def particles(self) -> Particles:
        """The molecules, and where they stand."""
        particles: Particles = self.parts["particles"]
        return particles

    @property
    def initial(self) -> State:
        """The start, on the rows."""
        initial: State = self.parts["initial"]
        return initial

    @property
    def dt(self) -> float:
        """Step."""
        dt: float = self.parts["dt"]
        return dt

    @property
    def record(self) -> Record:
        """The quantities that results hold."""
        record: Record = self.parts["record"]
        return record

    @property
    def method(self) -> Integrator:
        """The integrator."""
        method: Integrator = self.parts["integrator"]
        return method

    def system(self) -> ParticleSystem:
        """The points and what acts on them.

        Raises:
            SceneError: The solver is `compiled`, and nothing can be compiled here.
        """
        return self._system

    @cached_property
    def _system(self) -> ParticleSystem:
        kind = self.parts["solver"].type
        return system_for(self.particles.system, self.units.force, kind, f"{self.name}: solver")

    def stepper(
        self, *, dt: float | None = None, integrator: Mapping[str, Any] | None = None
    ) -> ParticleVerlet:
        """Steps of the points.

        Args:
            dt: In place of that of the scene.
            integrator: Entry in place of that of the scene.

        Raises:
            SceneError: No method for particles.
        """
        method = self.method if integrator is None else _method(integrator, self.name)
        try:
            stepper: Any = method.prepare_particles(self.system(), self.dt if dt is None else dt)
        except ModelError as error:
            raise SceneError(f"{self.name}: integrator: {error}") from error
        steps: ParticleVerlet = stepper
        return steps

    def __repr__(self) -> str:
        kinds = ", ".join(f"{kind.count} {kind.name}" for kind in self.system().kinds)
        return f"ParticleScene {self.name}: {kinds}; units {self.units.name}"


def system_for(system: ParticleSystem, force_unit: str, kind: str, where: str) -> ParticleSystem:
    """The system as the section `solver` asks for it.

    Args:
        system: The plain one.
        force_unit: For the names of multipliers.
        kind: plain, compiled or auto.
        where: File and key, for the messages.

    Raises:
        SceneError: It must be compiled and cannot be.
    """
    if kind == "plain":
        return system
    try:
        return compiled_system(system, force_unit)
    except (MbdError, ImportError) as error:
        if kind == "auto":
            return system
        raise SceneError(f"{where}: {error}") from error


def compiled_system(system: ParticleSystem, force_unit: str) -> ParticleSystem:
    """The system with native forces of pairs, and native steps where a kind has them.

    Raises:
        MbdError: There is no compiler, or a package is missing.
    """
    pairs: Any = system.pairs
    if isinstance(pairs, Pairs):
        from mbd_ros.compiled.particles.pair_kernel import CompiledKernel

        pairs = pairs.with_kernel(CompiledKernel(pairs.model))
    return ParticleSystem(system.kinds, pairs, force_unit, _steps(system))


def _steps(system: ParticleSystem) -> Callable[[Molecules, float, bool], KindSteps] | None:
    """Return a function for half steps of a kind of molecule; None without native code."""
    if not any(len(kind.atoms) == 3 and len(kind.rows) == 3 for kind in system.kinds):
        return None
    from mbd_ros.compiled.particles.molecule_steps import CompiledTriangles, is_compiled

    def steps(kind: Molecules, tolerance: float, projects: bool) -> KindSteps:
        made_by = CompiledTriangles if is_compiled(kind) else KindSteps
        return made_by(kind, tolerance, projects)

    return steps


def _method(entry: Any, where: str) -> Integrator:
    kind = entry.get("type") if isinstance(entry, Mapping) else entry
    if kind not in METHODS:
        raise SceneError(
            f"{where}: {kind!r} does not step particles; accepted: {', '.join(METHODS)}"
        )
    method: Integrator = build_part("integrators", entry, where)
    return method


def build_particle_scene(origin: Origin, entries: Mapping[str, Any]) -> ParticleScene:
    """A scene of entries that have a section `particles`.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    refuse_unknown(origin, [key for key in entries if key not in keys(PARTICLES)], PARTICLES)
    entries = present(entries)
    return ParticleScene(origin, build(origin, entries, PARTICLES).parts, entries)


def build_method(site: Any, entry: Any) -> Integrator:
    """The section `integrator`."""
    return _method(entry, site.where)
