"""Collocation on an interval: points, and integrals of polynomials through values at them.

    x(s) = x0 + h sum_k A_k(s) x'_k,   A_k(s) = integral of l_k from 0 to s

l_k are the polynomials of Lagrange of the points c_k in 0 .. 1.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, sec. IV.5.
"""

from functools import cache, cached_property

import numpy as np
from numpy.polynomial import legendre

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

GAUSS, RADAU, HERMITE_SIMPSON = "gauss", "radau", "hermite_simpson"
SCHEMES = (GAUSS, RADAU, HERMITE_SIMPSON)
LARGEST_DEGREE = 16
_DENSE = 1.0e-12  # of a coefficient: rounding


class Collocation:
    """A scheme of one degree.

    Args:
        scheme: One of `SCHEMES`; Hermite and Simpson's is the one of Lobatto with three points.
        degree: Number of points.

    Attributes:
        c: The points, shape (degree,).
        A: A_k(c_j), shape (degree, degree).
        b: A_k(1), shape (degree,).

    Raises:
        ModelError: A degree that the scheme does not have.
    """

    def __init__(self, scheme: str, degree: int) -> None:
        least, most = (3, 3) if scheme == HERMITE_SIMPSON else (1, LARGEST_DEGREE + 1)
        if not least <= degree <= most:
            raise ModelError(
                f"degree {degree} of {scheme}, accepted: {least} .. {most - (most > 3)}"
            )
        self.scheme, self.degree = scheme, degree
        self.c = _points(scheme, degree)
        self._to_series = np.linalg.inv(legendre.legvander(2.0 * self.c - 1.0, degree - 1))
        self._to_integrals: Array = legendre.legint(self._to_series, lbnd=-1, scl=0.5, axis=0)
        self.A = self.integrals(self.c)
        self.b = self.integrals(np.ones(1))[0]

    @property
    def joins_inputs(self) -> bool:
        """Whether both ends are points, so that neighbours share their inputs there."""
        return self.scheme == HERMITE_SIMPSON

    @property
    def finer(self) -> "Collocation":
        """Gauss's points, one more than this one has."""
        return collocation(GAUSS, self.degree + 1)

    def values(self, s: Array) -> Array:
        """l_k at some places, shape (n, degree).

        Args:
            s: Places in 0 .. 1, shape (n,).
        """
        series = legendre.legvander(2.0 * np.asarray(s, dtype=np.float64) - 1.0, self.degree - 1)
        found: Array = series @ self._to_series
        return found

    def integrals(self, s: Array) -> Array:
        """A_k at some places, shape (n, degree).

        Args:
            s: Places in 0 .. 1, shape (n,).
        """
        series = legendre.legvander(2.0 * np.asarray(s, dtype=np.float64) - 1.0, self.degree)
        found: Array = series @ self._to_integrals
        found[np.abs(found) < _DENSE] = 0.0
        return found

    def powers(self) -> Array:
        """Coefficients of the l_k by rising power of s, shape (degree, degree); do not write."""
        return self._powers

    @cached_property
    def _powers(self) -> Array:
        columns = [
            np.polynomial.Legendre(one, domain=[0.0, 1.0]).convert(kind=np.polynomial.Polynomial)
            for one in self._to_series.T
        ]
        found = np.zeros((self.degree, self.degree))
        for k, one in enumerate(columns):
            found[: len(one.coef), k] = one.coef
        return found


@cache
def collocation(scheme: str, degree: int) -> Collocation:
    """The scheme of a degree, made once."""
    return Collocation(scheme, degree)


def _points(scheme: str, degree: int) -> Array:
    if scheme == HERMITE_SIMPSON:
        return np.array([0.0, 0.5, 1.0])
    if scheme == GAUSS:
        return np.sort(0.5 * (legendre.leggauss(degree)[0] + 1.0))
    series = np.zeros(degree + 1)
    series[degree], series[degree - 1] = 1.0, -1.0  # P_d - P_(d - 1): its last zero is the end
    inner = np.sort(legendre.legroots(series).real)[:-1]
    return np.append(0.5 * (inner + 1.0), 1.0)
