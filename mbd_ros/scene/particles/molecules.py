"""The molecules of the section `particles`: atoms, sites, and what holds them together.

A bond or an angle without a stiffness is a rigid row, with one an elastic term; surfaces are rigid
and torsions elastic. A rigid angle is the distance between the ends of its two bonds.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from mbd_ros.core.ranges import NotNegative, Positive, Vector, Within
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError, SolveError
from mbd_ros.methods.particles.molecules import (
    ElasticAngle,
    ElasticBond,
    ElasticTerm,
    Field,
    Molecules,
    Torsion,
)
from mbd_ros.methods.particles.rigid_bonds import DistanceRow, PointRow, SurfaceRow
from mbd_ros.scene.reading.building import checked_name
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.nearest import nearest

Angle = Annotated[float, Within(0.0, math.pi)]
MOST = 3_000_000  # points
_WHOLE = 1.0e-6  # what weights may miss to 1, as they are rounded in files
Count = Annotated[int, Within(1, MOST)]
_SURFACES = ("sphere", "ellipsoid", "plane", "quadric")


@dataclass(frozen=True)
class Atom:
    """One point of a molecule.

    Attributes:
        at: Its position in the template.
        sigma: Diameter of its Lennard-Jones force.
        epsilon: Depth of it.
    """

    mass: Positive
    at: Vector
    charge: float = 0.0
    sigma: NotNegative = 0.0
    epsilon: NotNegative = 0.0


@dataclass(frozen=True)
class Site:
    """A point without mass, a weighted mean of the atoms of its molecule.

    Attributes:
        weights: Of atoms, by name; they sum to 1.
        sigma: Diameter of its Lennard-Jones force.
        epsilon: Depth of it.
    """

    weights: Mapping[str, float]
    charge: float = 0.0
    sigma: NotNegative = 0.0
    epsilon: NotNegative = 0.0


class MoleculeEntry(NamedTuple):
    """A kind of molecules, as read.

    Attributes:
        where: File and key, for the messages.
        atoms: Of one of them.
        sites: Of one of them.
        weights: Of the atoms in the sites, shape (sites, atoms).
        placement: Where they stand, as given.
    """

    where: str
    kind: Molecules
    atoms: tuple[Atom, ...]
    sites: tuple[Site, ...]
    weights: Array
    placement: Any


def read_molecule(name: str, value: Any, where: str, fields: tuple[Field, ...]) -> MoleculeEntry:
    """A kind of molecules.

    Args:
        value: What the file holds.
        where: File and key, for the messages.
        fields: What acts on its atoms.

    Raises:
        SceneError: Names file, key and atom.
    """
    checked_name(name, where)
    entry: _Molecule = schema.call(_Molecule, value, where)
    if not entry.atoms:
        raise SceneError(f"{where}.atoms: there is none")
    atoms = tuple(
        schema.call(Atom, one, f"{where}.atoms.{checked_name(key, f'{where}.atoms')}")
        for key, one in entry.atoms.items()
    )
    template = Template(where, tuple(entry.atoms), np.array([atom.at for atom in atoms]))
    _refuse_same_places(template)
    rows, terms = joined(template, entry.bonds, entry.angles, entry.torsions)
    rows += surfaces(template, entry.surfaces, _extent(template.at))
    masses = np.array([atom.mass for atom in atoms])
    parts = tuple(rows), tuple(terms), fields
    loose = Molecules(name, template.names, masses, template.at, entry.count, *parts)
    at = _assembled(loose, where)
    kind = Molecules(name, template.names, masses, at, entry.count, *parts)
    return MoleculeEntry(where, kind, atoms, *_sites(template, entry.sites), entry.placement)


@dataclass(frozen=True)
class _Molecule:
    """An entry of `molecules`."""

    atoms: Mapping[str, Any]
    bonds: Any = None
    angles: Any = None
    torsions: Any = None
    surfaces: Any = None
    sites: Any = None
    count: Count = 1
    placement: Any = None


class Template(NamedTuple):
    """One molecule.

    Attributes:
        where: File and key, for the messages.
        names: Of its atoms.
        at: Their positions, shape (atoms, 3).
    """

    where: str
    names: tuple[str, ...]
    at: Array

    def number(self, name: Any, where: str) -> int:
        """The number of an atom.

        Raises:
            SceneError: There is none of that name.
        """
        if name in self.names:
            return self.names.index(name)
        close = ", ".join(nearest(str(name), self.names) or self.names)
        raise SceneError(f"{where}: there is no atom {name!r}, accepted: {close}")

    def numbers(self, names: Any, count: int, where: str) -> list[int]:
        """The numbers of several different atoms.

        Raises:
            SceneError: Not so many, unknown or repeated names.
        """
        if not isinstance(names, list) or len(names) != count:
            raise SceneError(f"{where}: expected {count} names of atoms, got {names!r}")
        found = [self.number(name, where) for name in names]
        if len(set(found)) < count:
            raise SceneError(f"{where}: {', '.join(names)}: an atom is named twice")
        return found


def _refuse_same_places(template: Template) -> None:
    """Refuse two atoms of a template at one place."""
    for i, name in enumerate(template.names):
        same = np.flatnonzero((template.at[:i] == template.at[i]).all(axis=1))
        if len(same):
            other = template.names[int(same[0])]
            raise SceneError(f"{template.where}.atoms: {other} and {name} are at the same place")


class Joined(NamedTuple):
    """Rows and terms of a molecule."""

    rows: list[PointRow]
    terms: list[ElasticTerm]


def joined(template: Template, bonds: Any, angles: Any, torsions: Any) -> Joined:
    """Bonds, angles and torsions of a molecule.

    Raises:
        SceneError: Names file, key and atom.
    """
    rows: list[PointRow] = []
    terms: list[ElasticTerm] = []
    lengths: dict[frozenset[int], float] = {}
    for where, entry in _entries(template, "bonds", bonds):
        bond = schema.call(_Bond, entry, where)
        i, j = template.numbers(bond.between, 2, where)
        apart = float(np.linalg.norm(template.at[i] - template.at[j]))
        length = apart if bond.length is None else bond.length
        if apart == 0.0:
            raise SceneError(f"{where}: {' and '.join(bond.between)} are at the same place")
        if frozenset((i, j)) in lengths:
            raise SceneError(f"{where}: {' and '.join(bond.between)} are bound twice")
        lengths[frozenset((i, j))] = length
        if bond.stiffness is None:
            rows.append(DistanceRow("_".join(bond.between), i, j, length))
        else:
            terms.append(ElasticBond(i, j, length, bond.stiffness))
    for where, entry in _entries(template, "angles", angles):
        _add_angle(template, where, entry, lengths, (rows, terms))
    for where, entry in _entries(template, "torsions", torsions):
        torsion = schema.call(_Torsion, entry, where)
        first, second, third, fourth = template.numbers(torsion.between, 4, where)
        terms.append(Torsion((first, second, third, fourth), tuple(torsion.cosines)))
    return Joined(rows, terms)


def _entries(template: Template, key: str, value: Any) -> list[tuple[str, Any]]:
    if value is None:
        return []
    where = f"{template.where}.{key}"
    if not isinstance(value, list):
        raise SceneError(f"{where}: expected a list, got {value!r}")
    return [(f"{where}[{i}]", entry) for i, entry in enumerate(value)]


@dataclass(frozen=True)
class _Bond:
    between: Sequence[str]
    length: Positive | None = None
    stiffness: Positive | None = None


def _add_angle(
    template: Template,
    where: str,
    entry: Any,
    lengths: Mapping[frozenset[int], float],
    out: tuple[list[PointRow], list[ElasticTerm]],
) -> None:
    """A rigid angle is the distance of its ends; both its bonds must have lengths."""
    angle = schema.call(_Angle, entry, where)
    i, j, k = template.numbers(angle.between, 3, where)
    a, b = template.at[i] - template.at[j], template.at[k] - template.at[j]
    size = angle.angle
    if size is None:
        size = math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a.dot(b)))
    if angle.stiffness is not None:
        out[1].append(ElasticAngle(i, j, k, size, angle.stiffness))
        return
    sides = [lengths.get(frozenset((j, end))) for end in (i, k)]
    if sides[0] is None or sides[1] is None:
        raise SceneError(
            f"{where}: a rigid angle needs bonds of {angle.between[1]} with both ends"
        )
    if not 0.0 < size < math.pi:
        raise SceneError(f"{where}: {size:g} rad: a rigid angle is neither 0 nor pi")
    length = math.sqrt(sides[0] ** 2 + sides[1] ** 2 - 2.0 * sides[0] * sides[1] * math.cos(size))
    out[0].append(DistanceRow(f"{angle.between[0]}_{angle.between[2]}", i, k, length))


@dataclass(frozen=True)
class _Angle:
    between: Sequence[str]
    angle: Angle | None = None
    stiffness: Positive | None = None


@dataclass(frozen=True)
class _Torsion:
    between: Sequence[str]
    cosines: Sequence[float]


def surfaces(template: Template, value: Any, length: float) -> list[PointRow]:
    """Rows that hold atoms on surfaces.

    Args:
        value: What the file holds.
        length: A length of the scene, for surfaces that have none.

    Raises:
        SceneError: Names file, key and atom.
    """
    rows: list[PointRow] = []
    for where, entry in _entries(template, "surfaces", value):
        surface = schema.call(_Surface, entry, where)
        number, name = template.number(surface.atom, f"{where}.atom"), surface.atom
        squares, normal, level, size = _quadric(surface, where, length)
        center = np.array(surface.center)
        rows.append(
            SurfaceRow(f"{name}_{surface.type}", number, squares, normal, center, level, size)
        )
    return rows


@dataclass(frozen=True)
class _Surface:
    atom: str
    type: str
    center: Vector = (0.0, 0.0, 0.0)
    radius: Positive | None = None
    semi_axes: Vector | None = None
    normal: Vector | None = None
    coefficients: Vector | None = None
    level: float | None = None


def _quadric(surface: _Surface, where: str, length: float) -> tuple[Array, Array, float, float]:
    """Squares, normal, level and size of a surface; |dg/dx| = 1 on spheres and planes."""
    kind, zero = surface.type, np.zeros(3)
    if kind not in _SURFACES:
        raise SceneError(f"{where}: unknown type {kind!r}, accepted: {', '.join(_SURFACES)}")
    if kind == "sphere":
        radius = _needed(surface.radius, "radius", where)
        return np.full(3, 0.5 / radius), zero, 0.5 * radius, radius
    if kind == "ellipsoid":
        axes = np.array(_needed(surface.semi_axes, "semi_axes", where))
        if not (axes > 0.0).all():
            raise SceneError(f"{where}.semi_axes: {axes}: must be > 0")
        least = float(axes.min())
        return 0.5 * least / axes**2, zero, 0.5 * least, least
    if kind == "plane":
        normal = np.array(_needed(surface.normal, "normal", where))
        size = float(np.linalg.norm(normal))
        if size == 0.0:
            raise SceneError(f"{where}.normal: has no direction")
        return zero, normal / size, 0.0, length
    squares = np.array(_needed(surface.coefficients, "coefficients", where))
    level = _needed(surface.level, "level", where)
    if level == 0.0 or not (squares * level > 0.0).any():
        raise SceneError(f"{where}: no point has sum a x^2 = {level:g} with a = {squares}")
    return squares, zero, float(level), abs(float(level))


def _needed(value: Any, key: str, where: str) -> Any:
    if value is None:
        raise SceneError(f"{where}: key '{key}' is missing")
    return value


def _extent(at: Array) -> float:
    """A length of the molecule; 1 for one point."""
    extent = float(np.ptp(at, axis=0).max())
    return extent or float(np.abs(at).max()) or 1.0


def _assembled(kind: Molecules, where: str) -> Array:
    """The template on its rows.

    Raises:
        SceneError: They cannot all hold.
    """
    at = kind.at[:, :, None].copy()
    try:
        with np.errstate(all="ignore"):
            for cluster in kind.clusters:
                cluster.assemble(at)
    except SolveError as error:
        raise SceneError(
            f"{where}: its bonds, angles and surfaces cannot all hold: {error}; accepted: "
            "lengths that fit together, and atoms near such places"
        ) from error
    return at[:, :, 0]


def _sites(template: Template, entry: Any) -> tuple[tuple[Site, ...], Array]:
    """Sites of a molecule, and the weights of its atoms.

    Raises:
        SceneError: Names file, key and atom.
    """
    where, sites = f"{template.where}.sites", []
    if entry is not None and not isinstance(entry, Mapping):
        raise SceneError(f"{where}: expected a mapping, got {entry!r}")
    weights = np.zeros((len(entry or ()), len(template.names)))
    for row, (name, one) in zip(weights, (entry or {}).items(), strict=True):
        place = f"{where}.{checked_name(name, where)}"
        site: Site = schema.call(Site, one, place)
        for atom, weight in site.weights.items():
            row[template.number(atom, f"{place}.weights")] = weight
        if abs(row.sum() - 1.0) > _WHOLE:
            raise SceneError(f"{place}.weights: sum to {row.sum():.9g}, accepted: 1")
        sites.append(site)
    return tuple(sites), weights
