"""Rows between points: fixed distances, and points on surfaces of second order."""

from typing import NamedTuple

from mbd_ros.core.state import Array


def product(a: Array, b: Array) -> Array:
    """Products a . b of vectors side by side, (3, lanes) each, shape (lanes,).

    Written out, so that a lane has the same bits whatever stands beside it.
    """
    sum_: Array = a[0] * b[0]
    sum_ += a[1] * b[1]
    sum_ += a[2] * b[2]
    return sum_


class DistanceRow(NamedTuple):
    """Two points of a molecule at a fixed distance.

        g = (|d|^2 - L^2) / (2 L),  d = x_i - x_j,  dg/dx_i = d / L

    On the row d / L is a unit vector: the multiplier is the force that pushes both apart.

    Attributes:
        name: For columns and messages.
        i: Number of the first point in the molecule.
        j: Number of the second.
        length: L.
    """

    name: str
    i: int
    j: int
    length: float

    @property
    def ends(self) -> tuple[tuple[int, float], ...]:
        """The points, and the sign with which the direction pushes each."""
        return (self.i, 1.0), (self.j, -1.0)

    @property
    def size(self) -> float:
        """What g is compared with."""
        return self.length

    def direction(self, x: Array) -> Array:
        """The derivative by the first point, shape (3, lanes).

        Args:
            x: Positions, shape (atoms, 3, lanes).
        """
        d: Array = x[self.i] - x[self.j]
        d /= self.length
        return d

    def residual(self, x: Array, direction: Array) -> Array:
        """g, shape (lanes,), from the direction at the same positions."""
        g: Array = product(direction, direction)
        g -= 1.0
        g *= 0.5 * self.length
        return g

    def rate(self, v: Array, direction: Array) -> Array:
        """g', shape (lanes,)."""
        rate: Array = product(direction, v[self.i] - v[self.j])
        return rate

    def drift(self, v: Array) -> Array:
        """The part of g'' without the accelerations, shape (lanes,)."""
        d = v[self.i] - v[self.j]
        drift: Array = product(d, d) / self.length
        return drift


class SurfaceRow(NamedTuple):
    """A point of a molecule on a surface of second order.

        g = sum_k a_k (x_k - c_k)^2 + n . (x - c) - level

    Attributes:
        name: For columns and messages.
        i: Number of the point in the molecule.
        squares: a, shape (3,).
        normal: n, shape (3,).
        center: c, shape (3,).
        level: The value that is held.
        size: What g is compared with: a length of the scene times the size of dg/dx.
    """

    name: str
    i: int
    squares: Array
    normal: Array
    center: Array
    level: float
    size: float

    @property
    def ends(self) -> tuple[tuple[int, float], ...]:
        """The point, and the sign with which the direction pushes it."""
        return ((self.i, 1.0),)

    def direction(self, x: Array) -> Array:
        """dg/dx, shape (3, lanes)."""
        a, n, c = (part[:, None] for part in (self.squares, self.normal, self.center))
        direction: Array = 2.0 * a * (x[self.i] - c) + n
        return direction

    def residual(self, x: Array, direction: Array) -> Array:
        """g, shape (lanes,)."""
        a, n, c = (part[:, None] for part in (self.squares, self.normal, self.center))
        d = x[self.i] - c
        g: Array = product(a * d + n, d) - self.level
        return g

    def rate(self, v: Array, direction: Array) -> Array:
        """g', shape (lanes,)."""
        rate: Array = product(direction, v[self.i])
        return rate

    def drift(self, v: Array) -> Array:
        """The part of g'' without the accelerations, shape (lanes,)."""
        drift: Array = 2.0 * product(self.squares[:, None] * v[self.i], v[self.i])
        return drift


PointRow = DistanceRow | SurfaceRow
