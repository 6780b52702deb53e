"""Quintic B-splines of uniform knots at many places: sums over samples, and values."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mbd_ros.core.state import Array

DEGREE = 5
_WIDTH = DEGREE + 1  # splines that are not 0 in a cell


def _pieces() -> Array:
    """Coefficients of u^k, k = 0 .. 5, of the six splines of a cell, shape (spline, k).

    b_p(u) = 1/5! sum_j (-1)^j C(6, j) (u + 5 - p - j)^5 over the terms that are positive.
    """
    n, found = DEGREE, np.zeros((_WIDTH, _WIDTH))
    for p in range(n + 1):
        for j in range(n + 1 - p):
            shift, sign = n - p - j, (-1.0) ** j * math.comb(n + 1, j) / math.factorial(n)
            for k in range(n + 1):
                found[p, k] += sign * math.comb(n, k) * float(shift) ** (n - k)
    return found


_PIECES = _pieces()


class UniformBasis:
    """The splines of uniform cells at places within them.

    Args:
        places: In cells from the beginning on, increasing, shape (n,).
        cells: Number of cells; there are `cells + DEGREE` splines.

    Source: C. de Boor, A Practical Guide to Splines, 1978, chapter IX (truncated powers).
    """

    def __init__(self, places: Array, cells: int) -> None:
        places = np.clip(places, 0.0, cells)
        self._cells, self._n = cells, len(places)
        self._at = np.minimum(places.astype(np.intp), cells - 1)
        self._u = places - self._at
        self._starts = np.flatnonzero(np.diff(self._at, prepend=-1))
        self._used = self._at[self._starts]  # cells that hold a sample
        self._values = self._polynomials(_PIECES)

    def normal(self, weights: Array) -> Array:
        """Sums of weight b_i b_j over the samples, upper banded form, (DEGREE + 1, splines)."""
        found = np.zeros((_WIDTH, self._cells + DEGREE))
        splines = np.ascontiguousarray(self._values.T)
        for p, left in enumerate(splines):
            weighted = weights * left
            for q in range(p, _WIDTH):
                sums = np.add.reduceat(weighted * splines[q], self._starts)
                found[DEGREE - (q - p), self._used + q] += sums
        return found

    def projected(self, weights: Array, values: Array) -> Array:
        """Sums of weight b_i y over the samples; values of shape (n, m), result (splines, m)."""
        projected: Array = self._matrix(self._values).T @ (weights[:, None] * values)
        return projected

    def derivative(self, coefficients: Array, order: int) -> Array:
        """Derivative by the place of sums of splines at the samples, shape (n, m).

        Args:
            coefficients: Shape (splines, m).
            order: Of the derivative, 0 for the sums themselves.
        """
        factors = np.array([math.perm(k, order) for k in range(order, _WIDTH)])
        values = self._polynomials(_PIECES[:, order:] * factors) if order else self._values
        derivative: Array = self._matrix(values) @ np.ascontiguousarray(coefficients)
        return derivative

    def _polynomials(self, coefficients: Array) -> Array:
        """Values of polynomials of u, one a row of coefficients, shape (n, rows)."""
        found = np.empty((len(coefficients), self._n))
        for row, polynomial in zip(found, coefficients, strict=True):
            row[:] = polynomial[-1]
            for coefficient in polynomial[-2::-1]:
                row *= self._u
                row += coefficient
        return np.ascontiguousarray(found.T)

    def _matrix(self, values: Array) -> csr_array:
        """Splines, or derivatives of them, at the samples: shape (n, splines)."""
        indices: NDArray[np.intp] = (self._at[:, None] + np.arange(_WIDTH)).ravel()
        rows = np.arange(0, _WIDTH * self._n + 1, _WIDTH)
        shape = self._n, self._cells + DEGREE
        return csr_array((np.ascontiguousarray(values).ravel(), indices, rows), shape=shape)
