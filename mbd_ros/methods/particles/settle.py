"""SETTLE: rigid triangles of two equal sides, such as water, in closed form.

Of the four real solutions it takes the one with the smallest multipliers. The formulas take
numbers, arrays or symbols: a vector is three of them.

Source: S. Miyamoto, P. A. Kollman, J. Comput. Chem. 13, 1992, 952-962, doi:10.1002/jcc.540130805.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.methods.particles.rigid_bonds import Cluster, DistanceRow, PointRow

Vector = Any  # a sequence of three, or an array with three rows
_LANES = 1024  # that stay in the caches of a core together
_EQUAL = 1.0e-12  # relative difference of lengths or masses that is none


class Triangle(NamedTuple):
    """A rigid triangle of two equal sides.

    Attributes:
        atoms: Number of its apex in the molecule, then of both others.
        masses: Of the apex, and of each of the others.
        height: Distance of the apex from the centre of mass.
        depth: Distance of the base from it.
        half: Half the base.
    """

    atoms: tuple[int, int, int]
    masses: tuple[float, float]
    height: float
    depth: float
    half: float


def triangle_of(rows: Sequence[PointRow], masses: Array) -> Triangle | None:
    """The triangle that three rows make; None where they make no such one."""
    bonds = [row for row in rows if isinstance(row, DistanceRow)]
    atoms = sorted({i for row in bonds for i in (row.i, row.j)})
    if len(rows) != 3 or len(bonds) != 3 or len(atoms) != 3:
        return None
    opposite = {next(a for a in atoms if a not in (row.i, row.j)): row.length for row in bonds}
    for apex in atoms:
        b, c = (atom for atom in atoms if atom != apex)
        base, side = opposite[apex], opposite[b]
        unlike = abs(side / opposite[c] - 1.0), abs(masses[b] / masses[c] - 1.0)
        if max(unlike) <= _EQUAL and base < 2.0 * side:
            apart = float(np.sqrt(side**2 - 0.25 * base**2))
            light, heavy = float(masses[b]), float(masses[apex])
            height = apart * 2.0 * light / (heavy + 2.0 * light)
            return Triangle((apex, b, c), (heavy, light), height, apart - height, 0.5 * base)
    return None


def closed(
    triangle: Triangle,
    sides: tuple[Vector, Vector],
    loose: tuple[Vector, Vector, Vector],
    root: Any,
) -> tuple[Vector, Vector, Vector]:
    """Places of the corners about their centre of mass, on the rows.

    Args:
        sides: From the apex to both others before the step.
        loose: Places of the corners after the step without rows, about their centre of mass.
    """
    ra, rb, rc = triangle.height, triangle.depth, triangle.half
    z = cross(*sides)
    x = cross(loose[0], z)
    y = cross(z, x)
    x, y, z = (_scaled(axis, 1.0 / root(dot(axis, axis))) for axis in (x, y, z))
    xb, yb, xc, yc = dot(x, sides[0]), dot(y, sides[0]), dot(x, sides[1]), dot(y, sides[1])
    za, zb, zc = (dot(z, corner) for corner in loose)
    x1b, y1b, x1c, y1c = dot(x, loose[1]), dot(y, loose[1]), dot(x, loose[2]), dot(y, loose[2])
    sin_phi = za / ra
    cos_phi = root(1.0 - sin_phi * sin_phi)
    sin_psi = (zb - zc) / (2.0 * rc * cos_phi)
    cos_psi = root(1.0 - sin_psi * sin_psi)
    y2a, x2b, turned = ra * cos_phi, -rc * cos_psi, rc * sin_psi * sin_phi
    y2b, y2c = -rb * cos_phi - turned, -rb * cos_phi + turned
    alpha = x2b * (xb - xc) + yb * y2b + yc * y2c
    beta = x2b * (yc - yb) + xb * y2b + xc * y2c
    gamma = xb * y1b - x1b * yb + xc * y1c - x1c * yc
    square = alpha * alpha + beta * beta
    rest, inverse = root(square - gamma * gamma), 1.0 / square
    s, c = (alpha * gamma - beta * rest) * inverse, (beta * gamma + alpha * rest) * inverse
    a = _sum(x, -y2a * s, y, y2a * c, z, za)
    b = _sum(x, x2b * c - y2b * s, y, x2b * s + y2b * c, z, zb)
    end = _sum(x, -x2b * c - y2c * s, y, y2c * c - x2b * s, z, zc)
    return a, b, end


def cross(a: Vector, b: Vector) -> Vector:
    """A x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def dot(a: Vector, b: Vector) -> Any:
    """A . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _scaled(a: Vector, factor: Any) -> Vector:
    return tuple(one * factor for one in a)


def _sum(x: Vector, u: Any, y: Vector, v: Any, z: Vector, w: Any) -> Vector:
    return tuple(i * u + j * v + k * w for i, j, k in zip(x, y, z, strict=True))


def corrections(
    triangle: Triangle, before: Sequence[Vector], moved: Sequence[Vector], root: Any
) -> list[Vector]:
    """Return the corrections of the positions of the corners, three vectors.

    Args:
        before: Places of the corners before the step.
        moved: Places after it, without rows.
    """
    heavy, light = triangle.masses
    share = light / (heavy + 2.0 * light)
    sides = tuple(_minus(corner, before[0]) for corner in before[1:])
    b, c = (_minus(corner, moved[0]) for corner in moved[1:])
    a = tuple(-share * (i + j) for i, j in zip(b, c, strict=True))
    loose = a, _plus(b, a), _plus(c, a)
    ends = closed(triangle, (sides[0], sides[1]), loose, root)
    return [_minus(end, begin) for end, begin in zip(ends, loose, strict=True)]


def _minus(a: Vector, b: Vector) -> Vector:
    return tuple(i - j for i, j in zip(a, b, strict=True))


def _plus(a: Vector, b: Vector) -> Vector:
    return tuple(i + j for i, j in zip(a, b, strict=True))


def velocity_changes(
    triangle: Triangle, inverse: Array, places: Sequence[Vector], v: Sequence[Vector]
) -> list[Vector]:
    """Return the corrections of the velocities of the corners, three vectors.

    J M^-1 J' of a rigid triangle is a constant, and so is its inverse.

    Args:
        inverse: Of J M^-1 J' with sides that are not scaled: apex to b, apex to c, b to c.
        places: Of the corners.
    """
    d = [_minus(places[i], places[j]) for i, j in _SIDES]
    rates = [dot(one, _minus(v[i], v[j])) for one, (i, j) in zip(d, _SIDES, strict=True)]
    lam = [sum(-row[k] * rates[k] for k in range(3)) for row in inverse.tolist()]
    ab, ac, bc = (_scaled(one, each) for one, each in zip(d, lam, strict=True))
    heavy, light = 1.0 / triangle.masses[0], 1.0 / triangle.masses[1]
    return [
        _scaled(_plus(ab, ac), heavy),
        _scaled(_minus(bc, ab), light),
        tuple(-light * (i + j) for i, j in zip(ac, bc, strict=True)),
    ]


_SIDES = ((0, 1), (0, 2), (1, 2))


def inverse_metric(triangle: Triangle) -> Array:
    """The inverse of J M^-1 J' with sides as they are, apex to b, apex to c, b to c."""
    apart, half = triangle.height + triangle.depth, triangle.half
    at = np.array([[0.0, 0.0], [apart, half], [apart, -half]])
    mobility = np.array([1.0 / triangle.masses[k] for k in (0, 1, 1)])
    J = np.zeros((3, 3, 2))
    for row, (i, j) in enumerate(_SIDES):
        J[row, i], J[row, j] = at[i] - at[j], at[j] - at[i]
    inverse: Array = np.linalg.inv(np.einsum("aik,i,bik->ab", J, mobility, J))
    return inverse


class SettledCluster(Cluster):
    """Rows of a rigid triangle of two equal sides: solved in closed form.

    Args:
        masses: Of all points of the molecule, shape (atoms,).
        at: Positions of the template, shape (atoms, 3).
        triangle: What the rows make.
    """

    def __init__(
        self, rows: Sequence[PointRow], masses: Array, at: Array, triangle: Triangle
    ) -> None:
        super().__init__(rows, masses, at)
        self.triangle = triangle
        self.inverse = inverse_metric(triangle)

    def close(self, x: Array, moved: Array, w: Array, h: float, tolerance: float) -> None:
        """Close the rows like `Cluster.close`, without iterations."""
        for some in _chunks(x.shape[2]):
            before, after = (
                [part[i, :, some] for i in self.triangle.atoms] for part in (x, moved)
            )
            with np.errstate(invalid="ignore", divide="ignore"):
                change = corrections(self.triangle, before, after, np.sqrt)
            if not np.isfinite(change[0][0].sum()):
                lane = some.start + int(np.flatnonzero(~np.isfinite(change[0][0]))[0])
                raise SolveError(f"row {self.rows[0].name}, molecule {lane + 1}: no solution")
            _add(moved, self.triangle.atoms, change, some)
            _add(w, self.triangle.atoms, change, some, 1.0 / h)

    def project(self, x: Array, v: Array) -> None:
        """Project velocities like `Cluster.project`, with a constant matrix."""
        for some in _chunks(x.shape[2]):
            places, speeds = ([part[i, :, some] for i in self.triangle.atoms] for part in (x, v))
            change = velocity_changes(self.triangle, self.inverse, places, speeds)
            _add(v, self.triangle.atoms, change, some)


def _add(
    out: Array, atoms: Sequence[int], change: Sequence[Vector], some: slice, factor: float = 1.0
) -> None:
    for i, of_atom in zip(atoms, change, strict=True):
        for k, one in enumerate(of_atom):
            out[i, k, some] += one if factor == 1.0 else factor * one


def _chunks(lanes: int) -> list[slice]:
    return [slice(k, min(k + _LANES, lanes)) for k in range(0, lanes, _LANES)]
