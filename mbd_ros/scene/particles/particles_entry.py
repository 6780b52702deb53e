"""The sections of a scene of particles, but for its units."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from mbd_ros.core.particles.pairs import Pairs
from mbd_ros.core.particles.particle_system import ParticleSystem
from mbd_ros.core.particles.units import Units
from mbd_ros.core.ranges import LARGEST, NotNegative, Vector, Within
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SceneError, SolveError
from mbd_ros.scene.particles.field_entries import read_fields
from mbd_ros.scene.particles.molecule_entries import MOST, MoleculeEntry, read_molecule
from mbd_ros.scene.particles.pair_entries import read_pairs, refuse_overlap
from mbd_ros.scene.particles.placement import Room, placed
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.nearest import nearest

Seed = Annotated[int, Within(0, 2**63 - 1)]
Step = Annotated[float, Within(1.0e-30, LARGEST)]
QUANTITIES = ("positions", "velocities", "multipliers")


class Particles(NamedTuple):
    """The section `particles`, built.

    Attributes:
        system: The points.
        entries: Its kinds of molecules, as read.
        box: Edges of the periodic box; None without one.
        at: Positions at the start, shape (n, 3).
    """

    system: ParticleSystem
    entries: tuple[MoleculeEntry, ...]
    box: Array | None
    at: Array


@dataclass(frozen=True)
class _Entry:
    """The section `particles`."""

    molecules: Mapping[str, Any]
    box: Vector | None = None
    fields: Any = None
    pairs: Any = None


def build_particles(site: Site, given: Any) -> Particles:
    """The section `particles`.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    where, units = site.where, site.parts["units"]
    entry: _Entry = schema.call(_Entry, given, where)
    box = _box(entry.box, f"{where}.box")
    fields = read_fields(entry.fields, f"{where}.fields")
    if not entry.molecules:
        raise SceneError(f"{where}.molecules: there is none")
    entries = tuple(
        read_molecule(name, one, f"{where}.molecules.{name}", fields)
        for name, one in entry.molecules.items()
    )
    count = sum(one.kind.size for one in entries)
    if count > MOST:
        raise SceneError(f"{where}: {count} particles, accepted are {MOST}")
    room = Room(site.origin.folder, units, box)
    at = np.concatenate([placed(one, room) for one in entries])
    pairs = None
    if entry.pairs is not None:
        pairs = read_pairs(entry.pairs, f"{where}.pairs", entries, box, units)
    system = ParticleSystem([one.kind for one in entries], pairs, units.force)
    _refuse_repeated(system, where)
    return Particles(system, entries, box, at)


def _box(given: Sequence[float] | None, where: str) -> Array | None:
    if given is None:
        return None
    box = np.array(given)
    if not (box > 0.0).all():
        raise SceneError(f"{where}: {given}: edges must be > 0")
    return box


def _refuse_repeated(system: ParticleSystem, where: str) -> None:
    """Refuse points of one name, of two kinds of which there is one molecule each."""
    names = [name for kind in system.kinds if kind.count == 1 for name in kind.labels]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise SceneError(f"{where}.molecules: two atoms are called {twice[0]}; rename one")


@dataclass(frozen=True)
class _Initial:
    """The section `initial` of particles."""

    position: Mapping[str, Any] | None = None
    velocity: Mapping[str, Any] | None = None
    temperature: NotNegative | None = None
    seed: Seed = 0


def build_start(site: Site, given: Any) -> State:
    """The section `initial`: positions and velocities, moved onto the rows.

    Raises:
        SceneError: Names file, key and particle.
    """
    entry: _Initial = schema.call(_Initial, given, site.where)
    particles: Particles = site.parts["particles"]
    units: Units = site.parts["units"]
    system, q, v = particles.system, particles.at.copy(), np.zeros_like(particles.at)
    if entry.temperature is not None:
        draws = np.random.Generator(np.random.Philox(entry.seed)).normal(size=v.shape)
        v = draws * np.sqrt(units.boltzmann * entry.temperature / system.masses)[:, None]
    for key, values, out in (("position", entry.position, q), ("velocity", entry.velocity, v)):
        for name, numbers in (values or {}).items():
            where = f"{site.where}.{key}.{name}"
            out[_number(system, name, where)] = schema.value(numbers, Vector, where)
    try:
        x = system.projected(State(0.0, q.ravel(), v.ravel()))
    except SolveError as error:
        raise SceneError(f"{site.where}: the rows cannot all hold: {error}") from error
    if isinstance(system.pairs, Pairs):
        refuse_overlap(system, system.pairs, x.q.reshape(-1, 3), site.where)
    return x


def _number(system: ParticleSystem, name: str, where: str) -> int:
    if name not in system.names:
        close = ", ".join(nearest(name, system.names) or system.names[:5])
        raise SceneError(f"{where}: there is no such particle; nearest: {close}")
    return system.names.index(name)


def build_time_step(site: Site, given: Any) -> float:
    """The section `dt`, in the unit of time of the scene."""
    step: float = schema.value(given, Step, site.where)
    return step


@dataclass(frozen=True)
class Record:
    """The section `record`.

    Attributes:
        every: Steps from one sample to the next.
        quantities: What the samples hold beside energies; None chooses by the number of particles.
    """

    every: Annotated[int, Within(1, 10**9)] = 1
    quantities: Sequence[str] | None = None


def build_record(site: Site, given: Any) -> Record:
    """The section `record`."""
    record: Record = schema.call(Record, given, site.where)
    for name in record.quantities or ():
        if name not in QUANTITIES:
            accepted = ", ".join(QUANTITIES)
            raise SceneError(f"{site.where}.quantities: unknown {name!r}, accepted: {accepted}")
    return record


@dataclass(frozen=True)
class ParticleSolver:
    """The section `solver` of particles.

    Attributes:
        type: Whether forces of pairs and steps of rigid triangles are native code: `plain` not,
            `compiled` always, `auto` where there is a compiler.
    """

    type: Literal["plain", "compiled", "auto"] = "plain"


def build_solver(site: Site, given: Any) -> ParticleSolver:
    """The section `solver`."""
    solver: ParticleSolver = schema.call(ParticleSolver, given, site.where)
    return solver
