"""The sections of a scene of particles."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from mbd_ros.core.ranges import LARGEST, NotNegative, Vector, Within
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SceneError, SolveError
from mbd_ros.methods.particles.molecules import Field, Molecules, PolynomialField, UniformField
from mbd_ros.methods.particles.pairs import Pairs
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.rigid_bonds import DistanceRow
from mbd_ros.methods.particles.units import MOLECULAR, REDUCED, SI, UNITS, Units
from mbd_ros.scene.particles.molecules import MOST, MoleculeEntry, read_molecule
from mbd_ros.scene.particles.pair_entries import read_pairs, refuse_overlap
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.nearest import nearest

# ---- particles entry --------------------------------------------------------------------------
# The sections of a scene of particles, but for its units.


# Where molecules stand at the start.

_UNLIKE = 0.4  # of a length: what its bond in a file differs by, if it is that bond


@dataclass(frozen=True)
class _Placement:
    positions: Sequence[Any] | None = None
    file: str | None = None
    lattice: str | None = None
    seed: Annotated[int, Within(0, 2**63 - 1)] = 0


class Room(NamedTuple):
    """What placements need to know.

    Attributes:
        folder: Where relative paths start.
        units: Of the scene.
        box: Edges of the periodic box; None without one.
    """

    folder: Path
    units: Units
    box: Array | None


def placed(entry: MoleculeEntry, room: Room) -> Array:
    """Positions of all atoms of a kind, shape (count * atoms, 3).

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    kind, where = entry.kind, f"{entry.where}.placement"
    if entry.placement is None:
        if kind.count > 1 and room.box is not None:
            return _on_lattice(kind, room.box, 0)
        return np.tile(kind.at, (kind.count, 1))
    placement: _Placement = schema.call(_Placement, entry.placement, where)
    ways = (placement.positions, placement.file, placement.lattice)
    if sum(way is not None for way in ways) != 1:
        raise SceneError(f"{where}: give either 'positions', 'file' or 'lattice'")
    if placement.file is not None:
        return _from_file(kind, placement.file, room, where)
    if placement.positions is not None:
        offsets = _offsets(placement.positions, kind.count, f"{where}.positions")
        return (offsets[:, None] + kind.at).reshape(-1, 3)
    if placement.lattice != "cubic":
        raise SceneError(f"{where}.lattice: got {placement.lattice!r}, accepted: cubic")
    if room.box is None:
        raise SceneError(f"{where}.lattice: needs the key 'box' of particles")
    return _on_lattice(kind, room.box, placement.seed)


def _offsets(given: Sequence[Any], count: int, where: str) -> Array:
    try:
        offsets = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        offsets = np.zeros(0)
    if offsets.shape != (count, 3) or not np.isfinite(offsets).all():
        raise SceneError(f"{where}: expected {count} places of 3 numbers, one a molecule")
    return offsets


def _on_lattice(kind: Molecules, box: Array, seed: int) -> Array:
    """Centres of the cells of a cubic lattice, turned at random."""
    edge = math.ceil(kind.count ** (1.0 / 3.0) - 1.0e-9)
    cells = np.array(list(np.ndindex(edge, edge, edge)))[: kind.count]
    turns = np.random.Generator(np.random.Philox(seed)).normal(size=(kind.count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    center = kind.masses.dot(kind.at) / kind.masses.sum()
    turned = np.einsum("nij,aj->nai", _rotations(turns), kind.at - center)
    return (((cells + 0.5) / edge * box)[:, None] + turned).reshape(-1, 3)


def _rotations(unit: Array) -> Array:
    """Rotation matrices of unit quaternions (x, y, z, w), shape (n, 3, 3)."""
    v, w = unit[:, :3], unit[:, 3, None, None]
    cross = np.cross(np.eye(3)[None], v[:, None, :])
    rotations: Array = np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
    return rotations


def _from_file(kind: Molecules, name: str, room: Room, where: str) -> Array:
    from mbd_ros.scene.particles.molecules import read_coordinates
    from mbd_ros.scene.schema.locate import find_file

    path = find_file(room.folder, name, f"{where}.file")
    if not room.units.sizes:
        raise SceneError(
            f"{where}.file: {path} has units of its own, a scene in reduced units not"
        )
    metres = read_coordinates(path, f"{where}.file")
    if len(metres) != kind.size:
        raise SceneError(
            f"{where}.file: {path} has {len(metres)} atoms, accepted: {kind.size}, "
            f"{kind.count} times {', '.join(kind.atoms)}"
        )
    return _whole(kind, metres / room.units.sizes[0], room.box, f"{where}.file: {path}")


def _whole(kind: Molecules, x: Array, box: Array | None, where: str) -> Array:
    """The same positions, molecules that the box cuts put together.

    Raises:
        SceneError: A bond is far from its length: the atoms stand in another order.
    """
    whole = x.reshape(kind.count, -1, 3)
    if box is not None:
        whole = whole - box * np.rint((whole - whole[:, :1]) / box)
    for row in kind.rows:
        if not isinstance(row, DistanceRow):
            continue
        apart = np.linalg.norm(whole[:, row.i] - whole[:, row.j], axis=1)
        k = int(np.argmax(np.abs(apart / row.length - 1.0)))
        if not abs(apart[k] / row.length - 1.0) <= _UNLIKE:
            raise SceneError(
                f"{where}: {row.name} of molecule {k + 1} is {apart[k]:.3g} long, accepted: about "
                f"{row.length:.3g}; are its atoms in the order {', '.join(kind.atoms)}?"
            )
    return whole.reshape(-1, 3)


# External fields of a scene of particles.

_HIGHEST = 12  # power of a coordinate


@dataclass(frozen=True)
class _Uniform:
    acceleration: Vector


@dataclass(frozen=True)
class _Term:
    coefficient: float
    powers: Sequence[int]


@dataclass(frozen=True)
class _Polynomial:
    terms: Sequence[Any]


_TYPES = {"uniform": _Uniform, "polynomial": _Polynomial}


def read_fields(given: Any, where: str) -> tuple[Field, ...]:
    """The fields of the section.

    Raises:
        SceneError: Names file and key.
    """
    if given is None:
        return ()
    if not isinstance(given, list):
        raise SceneError(f"{where}: expected a list, got {given!r}")
    return tuple(_field(entry, f"{where}[{i}]") for i, entry in enumerate(given))


def _field(entry: Any, where: str) -> Field:
    kind = entry.get("type") if isinstance(entry, dict) else None
    if kind not in _TYPES:
        raise SceneError(f"{where}: unknown type {kind!r}, accepted: {', '.join(_TYPES)}")
    rest = {key: value for key, value in entry.items() if key != "type"}
    if kind == "uniform":
        uniform: _Uniform = schema.call(_Uniform, rest, where)
        return UniformField(np.array(uniform.acceleration))
    given: _Polynomial = schema.call(_Polynomial, rest, where)
    terms = [schema.call(_Term, term, f"{where}.terms[{i}]") for i, term in enumerate(given.terms)]
    for i, term in enumerate(terms):
        if len(term.powers) != 3 or not all(0 <= p <= _HIGHEST for p in term.powers):
            raise SceneError(
                f"{where}.terms[{i}].powers: {term.powers}, accepted: three whole numbers, "
                f"0 to {_HIGHEST}"
            )
    powers = np.array([term.powers for term in terms], dtype=np.float64).reshape(-1, 3)
    return PolynomialField(np.array([term.coefficient for term in terms]), powers)


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


# ---- units entry ------------------------------------------------------------------------------
# The `units` section of a scene of particles.


_KEYS = ("length", "time", "mass")
_ACCEPTED = (
    "si (m, s, kg), molecular (angstrom, ps, amu) or reduced, or "
    "{length: angstrom, time: ps, mass: amu}"
)


def build_units(site: Site, given: Any) -> Units:
    """Units by name, or by length, time and mass that belong together.

    Raises:
        SceneError: Other words, or units of two systems.
    """
    if isinstance(given, str) and given in UNITS:
        return UNITS[given]
    if not isinstance(given, Mapping) or set(given) != set(_KEYS):
        raise SceneError(f"{site.where}: got {given!r}, accepted: {_ACCEPTED}")
    words = tuple(given[key] for key in _KEYS)
    for units in (SI, MOLECULAR, REDUCED):
        if words == units.words[:3]:
            return units
    owners = {w: u.name for u in (SI, MOLECULAR) for w in u.words[:3]}
    unknown = [word for word in words if not isinstance(word, str) or word not in owners]
    if unknown:
        raise SceneError(f"{site.where}: unknown unit {unknown[0]!r}, accepted: {_ACCEPTED}")
    mixed = ", ".join(f"{word} of {owners[word]}" for word in words)
    raise SceneError(f"{site.where}: units of two systems, {mixed}; accepted: {_ACCEPTED}")
