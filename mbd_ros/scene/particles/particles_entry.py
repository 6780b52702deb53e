"""The sections of a scene of particles."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from mbd_ros.core.ranges import LARGEST, NotNegative, Positive, Vector, Within
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SceneError, SolveError
from mbd_ros.methods.particles.molecules import (
    Field,
    PolynomialField,
    SiteGroup,
    Sites,
    UniformField,
)
from mbd_ros.methods.particles.pairs import PairModel, Pairs, PlainKernel
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.units import MOLECULAR, REDUCED, SI, UNITS, Units
from mbd_ros.scene.particles.molecules import MOST, Atom, MoleculeEntry, Site, read_molecule
from mbd_ros.scene.particles.placement import Room, Seed, placed
from mbd_ros.scene.reading.building import Site as BuildingSite
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.nearest import nearest

_TREE = "mbd_ros.scene.particles.neighbour_tree"
_OVERLAP = 0.4  # of sigma: nearer points have energies that no liquid has
_ON_ONE_PLACE = 0.1  # of the largest sigma: the same of points that only have charges
_HIGHEST = 12  # power of a coordinate


@dataclass(frozen=True)
class _Uniform:
    acceleration: Vector


@dataclass(frozen=True)
class _Polynomial:
    terms: Sequence[Any]


_TYPES = {"uniform": _Uniform, "polynomial": _Polynomial}
Step = Annotated[float, Within(1.0e-30, LARGEST)]
QUANTITIES = ("positions", "velocities", "multipliers")
_KEYS = ("length", "time", "mass")
_ACCEPTED = (
    "si (m, s, kg), molecular (angstrom, ps, amu) or reduced, or "
    "{length: angstrom, time: ps, mass: amu}"
)


class Particles(NamedTuple):
    """The section `particles`, built.

    Attributes:
        entries: Its kinds of molecules, as read.
        box: Edges of the periodic box; None without one.
        at: Positions at the start, shape (n, 3).
    """

    system: ParticleSystem
    entries: tuple[MoleculeEntry, ...]
    box: Array | None
    at: Array


def build_particles(site: BuildingSite, value: Any) -> Particles:
    """The section `particles`.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    where, units = site.where, site.parts["units"]
    entry: _Entry = schema.call(_Entry, value, where)
    box = _box(entry.box, f"{where}.box")
    fields = read_fields(entry.fields, f"{where}.fields")
    if not entry.molecules:
        raise SceneError(f"{where}.molecules: there is none")
    entries = tuple(
        read_molecule(name, molecule, f"{where}.molecules.{name}", fields)
        for name, molecule in entry.molecules.items()
    )
    count = sum(molecule.kind.size for molecule in entries)
    if count > MOST:
        raise SceneError(f"{where}: {count} particles, accepted are {MOST}")
    room = Room(site.origin.folder, units, box)
    at = np.concatenate([placed(molecule, room) for molecule in entries])
    pairs = None
    if entry.pairs is not None:
        pairs = read_pairs(entry.pairs, f"{where}.pairs", entries, box, units)
    system = ParticleSystem([molecule.kind for molecule in entries], pairs, units.force)
    _refuse_repeated(system, where)
    return Particles(system, entries, box, at)


@dataclass(frozen=True)
class _Entry:
    """The section `particles`."""

    molecules: Mapping[str, Any]
    box: Vector | None = None
    fields: Any = None
    pairs: Any = None


def _box(edges: Sequence[float] | None, where: str) -> Array | None:
    if edges is None:
        return None
    box = np.array(edges)
    if not (box > 0.0).all():
        raise SceneError(f"{where}: {edges}: edges must be > 0")
    return box


def _refuse_repeated(system: ParticleSystem, where: str) -> None:
    """Refuse points of one name, of two kinds of which there is one molecule each."""
    names = [name for kind in system.kinds if kind.count == 1 for name in kind.labels]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise SceneError(f"{where}.molecules: two atoms are called {twice[0]}; rename one")


def build_start(site: BuildingSite, positions: Any) -> State:
    """The section `initial`: positions and velocities, moved onto the rows.

    Raises:
        SceneError: Names file, key and particle.
    """
    entry: _Initial = schema.call(_Initial, positions, site.where)
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


@dataclass(frozen=True)
class _Initial:
    """The section `initial` of particles."""

    position: Mapping[str, Any] | None = None
    velocity: Mapping[str, Any] | None = None
    temperature: NotNegative | None = None
    seed: Seed = 0


def _number(system: ParticleSystem, name: str, where: str) -> int:
    if name not in system.names:
        close = ", ".join(nearest(name, system.names) or system.names[:5])
        raise SceneError(f"{where}: there is no such particle; nearest: {close}")
    return system.names.index(name)


def refuse_overlap(system: ParticleSystem, pairs: Pairs, x: Array, where: str) -> None:
    """Refuse points of two molecules that are much nearer than they ever are.

    Args:
        x: Positions at the start, shape (n, 3).
        where: File and key, for the messages.

    Raises:
        SceneError: Names them and their distance.
    """
    model, names = pairs.model, system.names
    if pairs.sites is not None:
        x = pairs.sites.with_sites(x)
        names += pairs.sites.count * ("a site",)
    sigma = float(model.sigma.max()) or 0.01 * model.cutoff
    overlaps = pairs.pairs_within(x, _OVERLAP * sigma)
    d = x[overlaps.i] - x[overlaps.j]
    if model.box is not None:
        d -= model.box * np.rint(d / model.box)
    of_types = model.types[overlaps.i], model.types[overlaps.j]
    accepted = np.maximum(
        np.where(model.epsilon[of_types] > 0.0, _OVERLAP * model.sigma[of_types], 0.0),
        _ON_ONE_PLACE * sigma,
    )
    apart = np.linalg.norm(d, axis=1)
    if not (apart < accepted).any():
        return
    worst = int(np.argmin(apart / accepted))
    both = f"{names[overlaps.i[worst]]} and {names[overlaps.j[worst]]}"
    raise SceneError(
        f"{where}: {np.count_nonzero(apart < accepted)} pairs of particles overlap; {both} are "
        f"{apart[worst]:.3g} apart, accepted: {accepted[worst]:.3g} or more between molecules"
    )


def build_time_step(site: BuildingSite, entry: Any) -> float:
    """The section `dt`, in the unit of time of the scene."""
    step: float = schema.value(entry, Step, site.where)
    return step


def build_record(site: BuildingSite, entry: Any) -> Record:
    """The section `record`."""
    record: Record = schema.call(Record, entry, site.where)
    for name in record.quantities or ():
        if name not in QUANTITIES:
            accepted = ", ".join(QUANTITIES)
            raise SceneError(f"{site.where}.quantities: unknown {name!r}, accepted: {accepted}")
    return record


@dataclass(frozen=True)
class Record:
    """The section `record`.

    Attributes:
        every: Steps from one sample to the next.
        quantities: What the samples hold beside energies; None chooses by the number of particles.
    """

    every: Annotated[int, Within(1, 10**9)] = 1
    quantities: Sequence[str] | None = None


def build_solver(site: BuildingSite, entry: Any) -> ParticleSolver:
    """The section `solver`."""
    solver: ParticleSolver = schema.call(ParticleSolver, entry, site.where)
    return solver


@dataclass(frozen=True)
class ParticleSolver:
    """The section `solver` of particles.

    Attributes:
        type: Whether forces of pairs and steps of rigid triangles are native code: `plain` not,
            `compiled` always, `auto` where there is a compiler.
    """

    type: Literal["plain", "compiled", "auto"] = "plain"


def build_units(site: BuildingSite, entry: Any) -> Units:
    """Units by name, or by length, time and mass that belong together.

    Raises:
        SceneError: Other words, or units of two systems.
    """
    if isinstance(entry, str) and entry in UNITS:
        return UNITS[entry]
    if not isinstance(entry, Mapping) or set(entry) != set(_KEYS):
        raise SceneError(f"{site.where}: got {entry!r}, accepted: {_ACCEPTED}")
    words = tuple(entry[key] for key in _KEYS)
    for units in (SI, MOLECULAR, REDUCED):
        if words == units.symbols[:3]:
            return units
    owners = {w: u.name for u in (SI, MOLECULAR) for w in u.symbols[:3]}
    unknown = [word for word in words if not isinstance(word, str) or word not in owners]
    if unknown:
        raise SceneError(f"{site.where}: unknown unit {unknown[0]!r}, accepted: {_ACCEPTED}")
    mixed = ", ".join(f"{word} of {owners[word]}" for word in words)
    raise SceneError(f"{site.where}: units of two systems, {mixed}; accepted: {_ACCEPTED}")


def read_fields(value: Any, where: str) -> tuple[Field, ...]:
    """The fields of the section.

    Raises:
        SceneError: Names file and key.
    """
    if value is None:
        return ()
    if not isinstance(value, list):
        raise SceneError(f"{where}: expected a list, got {value!r}")
    return tuple(_field(entry, f"{where}[{i}]") for i, entry in enumerate(value))


def _field(entry: Any, where: str) -> Field:
    kind = entry.get("type") if isinstance(entry, dict) else None
    if kind not in _TYPES:
        raise SceneError(f"{where}: unknown type {kind!r}, accepted: {', '.join(_TYPES)}")
    rest = {key: value for key, value in entry.items() if key != "type"}
    if kind == "uniform":
        uniform: _Uniform = schema.call(_Uniform, rest, where)
        return UniformField(np.array(uniform.acceleration))
    positions: _Polynomial = schema.call(_Polynomial, rest, where)
    terms = [
        schema.call(_Term, term, f"{where}.terms[{i}]") for i, term in enumerate(positions.terms)
    ]
    for i, term in enumerate(terms):
        if len(term.powers) != 3 or not all(0 <= p <= _HIGHEST for p in term.powers):
            raise SceneError(
                f"{where}.terms[{i}].powers: {term.powers}, accepted: three whole numbers, "
                f"0 to {_HIGHEST}"
            )
    powers = np.array([term.powers for term in terms], dtype=np.float64).reshape(-1, 3)
    return PolynomialField(np.array([term.coefficient for term in terms]), powers)


@dataclass(frozen=True)
class _Term:
    coefficient: float
    powers: Sequence[int]


def read_pairs(
    value: Any, where: str, entries: tuple[MoleculeEntry, ...], box: Array | None, units: Units
) -> Pairs:
    """Forces between the molecules.

    Raises:
        SceneError: Names file and key.
    """
    entry: _PairsEntry = schema.call(_PairsEntry, value, where)
    if box is not None and entry.cutoff > 0.5 * float(box.min()):
        raise SceneError(
            f"{where}.cutoff: {entry.cutoff:g} is more than half the shortest edge of the box, "
            f"{box.min():g}: a point would feel two images of another"
        )
    atoms: list[Atom | Site] = [
        a for molecule in entries for _ in range(molecule.kind.count) for a in molecule.atoms
    ]
    sites = _sites(entries, len(atoms))
    atoms += [
        site for molecule in entries for _ in range(molecule.kind.count) for site in molecule.sites
    ]
    if not any(atom.charge or atom.epsilon for atom in atoms):
        raise SceneError(f"{where}: no atom has a charge, or sigma and epsilon")
    with np.errstate(all="ignore"):
        model = _model(entry.cutoff, box, atoms, units)
        if not np.isfinite(model.powers).all():
            raise SceneError(f"{where}: sigma and epsilon beside this cutoff overflow")
    numbers = np.arange(sum(molecule.kind.count for molecule in entries), dtype=np.int32)
    sizes = [
        [len(molecule.atoms), len(molecule.sites)]
        for molecule in entries
        for _ in range(molecule.kind.count)
    ]
    molecules = np.concatenate([np.repeat(numbers, size) for size in zip(*sizes, strict=True)])
    near = importlib.import_module(_TREE).near_pairs
    return Pairs(model, molecules, near, PlainKernel(model), sites)


@dataclass(frozen=True)
class _PairsEntry:
    """The key `pairs`."""

    cutoff: Positive
    coulomb: Literal["reaction_field"] = "reaction_field"
    lennard_jones: Literal["force_shifted"] = "force_shifted"


def _sites(entries: tuple[MoleculeEntry, ...], atoms: int) -> Sites | None:
    """The points without mass; None without any."""
    groups, first = [], 0
    for entry in entries:
        if entry.sites:
            groups.append(SiteGroup(first, entry.kind.count, entry.weights))
        first += entry.kind.size
    return Sites(groups, atoms) if groups else None


def _model(
    cutoff: float, box: Array | None, atoms: Sequence[Atom | Site], units: Units
) -> PairModel:
    kinds = list(dict.fromkeys((atom.sigma, atom.epsilon) for atom in atoms))
    numbers = {kind: number for number, kind in enumerate(kinds)}
    types = np.array([numbers[atom.sigma, atom.epsilon] for atom in atoms], dtype=np.int32)
    sigma, epsilon = np.array(kinds).T
    charges = np.sqrt(units.coulomb) * np.array([atom.charge for atom in atoms])
    mixed = 0.5 * (sigma[:, None] + sigma), np.sqrt(epsilon[:, None] * epsilon)
    return PairModel(cutoff, box, charges, types, *mixed)
