"""Quantities of configurations: samples are judged by them, forces averaged along them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

Indices = NDArray[np.intp]
_IMAGINARY = 1.0e-30  # of a coordinate, in the imaginary direction: derivatives to rounding


class Observable(NamedTuple):
    """A quantity of configurations.

    Attributes:
        name: As columns have it.
        unit: Empty for pure numbers.
        coordinates: Numbers of those it depends on.
        of: Function of these coordinates, shape (len(coordinates), n), to shape (n,). Where it
            is a coordinate along which forces are averaged it takes complex numbers.
    """

    name: str
    unit: str
    coordinates: Indices
    of: Callable[[Array], Array]

    def value(self, q: Array) -> Array:
        """Its values, shape (chains,).

        Args:
            q: Configurations, shape (size, chains).
        """
        return self.of(q[self.coordinates])

    def gradient(self, q: Array) -> Array:
        """Return the derivative by all coordinates, by complex steps, shape (size, chains)."""
        x, slope = q[self.coordinates].astype(complex), np.zeros(q.shape)
        for k, i in enumerate(self.coordinates):
            x[k] += 1j * _IMAGINARY
            slope[i] = self.of(x).imag / _IMAGINARY
            x[k] = x[k].real
        return slope


def point(number: int) -> Indices:
    """Coordinates of a particle."""
    return 3 * number + np.arange(3)


def coordinate(name: str, unit: str, number: int) -> Observable:
    """A coordinate itself."""
    return Observable(name, unit, np.array([number]), lambda x: x[0])


def distance(name: str, unit: str, a: int, b: int) -> Observable:
    """Distance of two particles."""
    return Observable(name, unit, _points(a, b), lambda x: _norm(x[:3] - x[3:]))


def cosine(name: str, a: int, b: int, c: int) -> Observable:
    """Cosine of the angle between the bonds from a to b and from b to c."""
    return Observable(name, "", _points(a, b, c), _cosine)


def angle(name: str, a: int, b: int, c: int) -> Observable:
    """Angle at b between a and c [rad]."""
    return Observable(name, "rad", _points(a, b, c), lambda x: np.arccos(-_cosine(x)))


def dihedral(name: str, points: Sequence[int]) -> Observable:
    """Dihedral angle of four particles [rad], 0 where the first and last are on one side."""
    return Observable(name, "rad", _points(*points), _dihedral)


def quadratic(name: str, unit: str, a: int, weights: Sequence[float]) -> Observable:
    """Sum of weighted squares of the coordinates of a particle."""
    w = np.array(weights)[:, None]
    return Observable(name, unit, point(a), lambda x: (w * x * x).sum(axis=0))


def area(name: str, unit: str, points: Sequence[int], normal: Array) -> Observable:
    """Signed area of three particles, seen against a normal."""
    n = normal[:, None]

    def of(x: Array) -> Array:
        a, b = x[3:6] - x[:3], x[6:] - x[:3]
        return 0.5 * (n * np.cross(a, b, axis=0)).sum(axis=0)

    return Observable(name, unit, _points(*points), of)


def volume(name: str, unit: str, points: Sequence[int]) -> Observable:
    """Signed volume of four particles."""

    def of(x: Array) -> Array:
        a, b, c = (x[3 * k : 3 * k + 3] - x[:3] for k in (1, 2, 3))
        return (a * np.cross(b, c, axis=0)).sum(axis=0) / 6.0

    return Observable(name, unit, _points(*points), of)


def _points(*numbers: int) -> Indices:
    return np.concatenate([point(number) for number in numbers])


def _norm(d: Array) -> Array:
    norm: Array = np.sqrt((d * d).sum(axis=0))
    return norm


def _cosine(x: Array) -> Array:
    a, b = x[3:6] - x[:3], x[6:] - x[3:6]
    cosine: Array = (a * b).sum(axis=0) / (_norm(a) * _norm(b))
    return cosine


def _dihedral(x: Array) -> Array:
    a, b, c = (x[3 * k + 3 : 3 * k + 6] - x[3 * k : 3 * k + 3] for k in range(3))
    m, n = np.cross(a, b, axis=0), np.cross(b, c, axis=0)
    along = (np.cross(m, n, axis=0) * b).sum(axis=0) / _norm(b)
    return np.arctan2(along, (m * n).sum(axis=0))
