"""Quintic B-splines of uniform knots at many places a cell: sums over samples, and values.

Within a cell every spline is a polynomial of u, the place from the middle of the cell on. So sums
over the samples of a cell are those of powers of u, and values are polynomials of each cell: small
products of matrices, a cell each.
"""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.jobs.inverse.spline_pieces import DEGREE, pieces

_WIDTH = DEGREE + 1  # splines that are not 0 in a cell
_LOOSE = 2.0  # places that rows of one length may take, per sample
_MIDDLE = 0.5
_PIECES = pieces(_MIDDLE)
_UPPER = tuple(itertools.combinations_with_replacement(range(_WIDTH), 2))
_PAIRS = np.array([np.outer(_PIECES[p], _PIECES[q]).ravel() for p, q in _UPPER])


class CellBasis:
    """What `UniformBasis` is, quicker where cells hold several samples.

    Samples of a cell stand in one row, or in several where cells differ much.

    Args:
        places: In cells from the beginning on, increasing, shape (n,).
        cells: Number of cells; there are `cells + DEGREE` splines.
    """

    def __init__(self, places: Array, cells: int) -> None:
        places = np.clip(places, 0.0, cells)
        self._cells, n = cells, len(places)
        at = np.minimum(places.astype(np.intp), cells - 1)
        starts = np.flatnonzero(np.diff(at, prepend=-1))
        self._used = at[starts]  # cells that hold a sample
        counts = np.diff(starts, append=n)
        length = int(counts.max())
        if length * len(counts) > _LOOSE * n:
            length = max(n // len(counts), 1)
        self._of_cell = -(-counts // length)  # rows
        self._first = np.cumsum(self._of_cell) - self._of_cell
        self._shape = int(self._of_cell.sum()), length
        self._places = np.repeat(self._first * length - starts, counts) + np.arange(n)
        size = self._shape[0] * length
        self._full = size == n  # every place of every row holds a sample
        self._powers = np.zeros((_WIDTH, size))
        self._powers[0, self._places] = 1.0
        self._powers[1, self._places] = places - at - _MIDDLE
        for k in range(2, _WIDTH):
            np.multiply(self._powers[k - 1], self._powers[1], out=self._powers[k])

    def normal(self, weights: Array) -> Array:
        """Sums of weight b_i b_j over the samples, upper banded form, (DEGREE + 1, splines)."""
        found = np.zeros((_WIDTH, self._cells + DEGREE))
        products = self._by_cells(self._weighted(weights) @ self._by_rows(self._powers).mT)
        sums = _PAIRS @ products.reshape(-1, _WIDTH * _WIDTH).T
        for (p, q), row in zip(_UPPER, sums, strict=True):
            found[DEGREE - (q - p), self._own(q)] += row
        return found

    def projected(self, weights: Array, values: Array) -> Array:
        """Sums of weight b_i y over the samples; values of shape (n, m), result (splines, m)."""
        m = values.shape[1]
        projected = np.zeros((self._cells + DEGREE, m))
        placed = values
        if not self._full:
            placed = np.zeros((self._powers.shape[1], m))
            placed[self._places] = values
        moments = self._by_cells(self._weighted(weights) @ placed.reshape(*self._shape, m))
        sums = _PIECES @ moments.swapaxes(0, 1).reshape(_WIDTH, -1)
        for p, of_cells in enumerate(sums.reshape(_WIDTH, -1, m)):
            projected[self._own(p)] += of_cells
        return projected

    def derivative(self, coefficients: Array, order: int) -> Array:
        """Derivative by the place of sums of splines at the samples, shape (n, m).

        Args:
            coefficients: Shape (splines, m).
            order: Of the derivative, 0 for the sums themselves.
        """
        m = coefficients.shape[1]
        own = np.stack([coefficients[self._own(p)] for p in range(_WIDTH)]).reshape(_WIDTH, -1)
        factors = np.array([math.perm(k, order) for k in range(order, _WIDTH)], dtype=np.float64)
        polynomials = ((_PIECES[:, order:] * factors).T @ own).reshape(len(factors), -1, m)
        if len(self._used) < self._shape[0]:
            polynomials = np.repeat(polynomials, self._of_cell, axis=1)
        powers = self._by_rows(self._powers[: _WIDTH - order])
        values: Array = (powers.mT @ polynomials.swapaxes(0, 1)).reshape(-1, m)
        return values if self._full else values[self._places]

    def _own(self, p: int) -> slice | NDArray[np.intp]:
        """The spline p of each cell that is used."""
        every = len(self._used) == self._cells
        return slice(p, p + self._cells) if every else self._used + p

    def _weighted(self, weights: Array) -> Array:
        """Powers times weights, shape (rows, 6, length)."""
        placed = np.zeros(self._powers.shape[1])
        placed[self._places] = weights
        return self._by_rows(self._powers * placed)

    def _by_rows(self, powers: Array) -> Array:
        """A view of powers, shape (rows, powers, length)."""
        return powers.reshape(-1, *self._shape).swapaxes(0, 1)

    def _by_cells(self, sums: Array) -> Array:
        """Sums of the rows of each cell that is used."""
        if len(self._used) == self._shape[0]:
            return sums
        by_cells: Array = np.add.reduceat(sums, self._first, axis=0)
        return by_cells
