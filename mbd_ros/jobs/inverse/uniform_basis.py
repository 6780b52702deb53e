"""Quintic B-splines of uniform knots at many places: sums over samples, and values."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mbd_ros.core.state import Array
from mbd_ros.jobs.inverse.spline_pieces import DEGREE, Wanted, pieces

_WIDTH = DEGREE + 1  # splines that are not 0 in a cell
_PIECES = pieces(0.0)


class UniformBasis:
    """The splines of uniform cells at places within them.

    Args:
        places: In cells from the beginning on, increasing, shape (n,).
        cells: Number of cells; there are `cells + DEGREE` splines.
        weights: Of the samples, shape (n,).
    """

    def __init__(self, places: Array, cells: int, weights: Array) -> None:
        self._weights = weights
        places = np.clip(places, 0.0, cells)
        self._cells, self._n = cells, len(places)
        self._at = np.minimum(places.astype(np.intp), cells - 1)
        self._u = places - self._at
        self._starts = np.flatnonzero(np.diff(self._at, prepend=-1))
        self._used = self._at[self._starts]  # cells that hold a sample
        small = _WIDTH * len(places) + cells < np.iinfo(np.int32).max
        kind = np.int32 if small else np.int64  # scipy takes 32 bits as they are
        self._indices = (self._at.astype(kind)[:, None] + np.arange(_WIDTH, dtype=kind)).ravel()
        self._rows = np.arange(0, _WIDTH * self._n + 1, _WIDTH, dtype=kind)
        self._values = self._polynomials(_PIECES)
        self._matrix = self._matrix_of(self._values)

    def normal(self) -> Array:
        """Sums of weight b_i b_j over the samples, upper banded form, (DEGREE + 1, splines)."""
        found = np.zeros((_WIDTH, self._cells + DEGREE))
        splines = np.ascontiguousarray(self._values.T)
        several, every = len(self._starts) < self._n, np.zeros(self._cells)
        for p, left in enumerate(splines):
            weighted = self._weights * left
            for q in range(p, _WIDTH):
                products = weighted * splines[q]
                sums = np.add.reduceat(products, self._starts) if several else products
                if len(sums) < self._cells:
                    every[self._used] = sums
                    sums = every
                found[DEGREE - (q - p), q : q + self._cells] += sums
        return found

    def projected(self, values: Array, chosen: NDArray[np.intp]) -> Array:
        """Sums of weight b_i y over the samples, y m rows of values; shape (splines, m)."""
        projected: Array = self._matrix.T @ (self._weights[:, None] * values[chosen].T)
        return projected

    def put(self, coefficients: Array, width: float, wanted: Wanted, rows: slice) -> None:
        """Derivatives of sums of splines at some samples.

        Args:
            coefficients: Shape (splines, m).
            width: Of a cell [s].
            wanted: See `spline_pieces.Wanted`.
            rows: The samples.
        """
        for order, columns, target, places in wanted:
            matrix = self._matrix
            if order:
                factors = np.array([math.perm(k, order) for k in range(order, _WIDTH)])
                matrix = self._matrix_of(self._polynomials(_PIECES[:, order:] * factors))
            own = np.ascontiguousarray(coefficients[:, columns]) / width**order
            target[:, places] = (matrix @ own)[rows]

    def _polynomials(self, coefficients: Array) -> Array:
        """Values of polynomials of u, one a row of coefficients, shape (n, rows)."""
        found = np.empty((len(coefficients), self._n))
        for row, polynomial in zip(found, coefficients, strict=True):
            row[:] = polynomial[-1]
            for coefficient in polynomial[-2::-1]:
                row *= self._u
                row += coefficient
        return np.ascontiguousarray(found.T)

    def _matrix_of(self, values: Array) -> csr_array:
        """Splines, or derivatives of them, at the samples: shape (n, splines)."""
        shape = self._n, self._cells + DEGREE
        return csr_array((values.ravel(), self._indices, self._rows), shape=shape)
