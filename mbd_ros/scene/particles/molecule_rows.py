"""Bonds, angles, torsions and surfaces of a molecule: rigid rows and elastic terms."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from mbd_ros.core.particles.elastic import ElasticAngle, ElasticBond, ElasticTerm, Torsion
from mbd_ros.core.particles.row_geometry import DistanceRow, PointRow, SurfaceRow
from mbd_ros.core.ranges import Positive, Vector, Within
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.nearest import nearest

Angle = Annotated[float, Within(0.0, math.pi)]
_SURFACES = ("sphere", "ellipsoid", "plane", "quadric")


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


@dataclass(frozen=True)
class _Bond:
    between: Sequence[str]
    length: Positive | None = None
    stiffness: Positive | None = None


@dataclass(frozen=True)
class _Angle:
    between: Sequence[str]
    angle: Angle | None = None
    stiffness: Positive | None = None


@dataclass(frozen=True)
class _Torsion:
    between: Sequence[str]
    cosines: Sequence[float]


class Joined(NamedTuple):
    """Rows and terms of a molecule.

    Attributes:
        rows: Rigid ones.
        terms: Elastic ones.
    """

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
    for where, given in _entries(template, "bonds", bonds):
        bond = schema.call(_Bond, given, where)
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
    for where, given in _entries(template, "angles", angles):
        _add_angle(template, where, given, lengths, (rows, terms))
    for where, given in _entries(template, "torsions", torsions):
        torsion = schema.call(_Torsion, given, where)
        first, second, third, fourth = template.numbers(torsion.between, 4, where)
        terms.append(Torsion((first, second, third, fourth), tuple(torsion.cosines)))
    return Joined(rows, terms)


def _add_angle(
    template: Template,
    where: str,
    given: Any,
    lengths: Mapping[frozenset[int], float],
    out: tuple[list[PointRow], list[ElasticTerm]],
) -> None:
    """A rigid angle is the distance of its ends; both its bonds must have lengths."""
    angle = schema.call(_Angle, given, where)
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
class _Surface:
    atom: str
    type: str
    center: Vector = (0.0, 0.0, 0.0)
    radius: Positive | None = None
    semi_axes: Vector | None = None
    normal: Vector | None = None
    coefficients: Vector | None = None
    level: float | None = None


def surfaces(template: Template, given: Any, length: float) -> list[PointRow]:
    """Rows that hold atoms on surfaces.

    Args:
        template: The molecule.
        given: What the file holds.
        length: A length of the scene, for surfaces that have none.

    Raises:
        SceneError: Names file, key and atom.
    """
    rows: list[PointRow] = []
    for where, entry in _entries(template, "surfaces", given):
        surface = schema.call(_Surface, entry, where)
        number, name = template.number(surface.atom, f"{where}.atom"), surface.atom
        squares, normal, level, size = _quadric(surface, where, length)
        center = np.array(surface.center)
        rows.append(
            SurfaceRow(f"{name}_{surface.type}", number, squares, normal, center, level, size)
        )
    return rows


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


def _entries(template: Template, key: str, given: Any) -> list[tuple[str, Any]]:
    if given is None:
        return []
    where = f"{template.where}.{key}"
    if not isinstance(given, list):
        raise SceneError(f"{where}: expected a list, got {given!r}")
    return [(f"{where}[{i}]", entry) for i, entry in enumerate(given)]
