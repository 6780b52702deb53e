"""Quintic B-splines of uniform knots at many places a cell: sums over samples, and values.

Within a cell every spline is a polynomial of u, the place from the middle of the cell on. So sums
over the samples of a cell are those of powers of u, and values are polynomials of each cell: small
products of matrices, a cell each. A block of samples at a time stays in the cache.
"""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.jobs.inverse.products import product
from mbd_ros.jobs.inverse.spline_pieces import DEGREE, Wanted, pieces

_WIDTH = DEGREE + 1  # splines that are not 0 in a cell
_LOOSE = 2.0  # places that rows of one length may take, per sample
_BLOCK = 8192  # samples
_MIDDLE = 0.5
_PIECES = pieces(_MIDDLE)
_UPPER = tuple(itertools.combinations_with_replacement(range(_WIDTH), 2))
_PAIRS = np.array([np.outer(_PIECES[p], _PIECES[q]).ravel() for p, q in _UPPER])


class CellBasis:
    """What `UniformBasis` is, quicker where cells hold several samples.

    Args:
        places: In cells from the beginning on, increasing, shape (n,).
        cells: Number of cells; there are `cells + DEGREE` splines.
        weights: Of the samples, shape (n,).
    """

    def __init__(self, places: Array, cells: int, weights: Array) -> None:
        self._cells, self._blocks = cells, list[tuple[slice, _Block]]()
        for begin in range(0, len(places), _BLOCK):
            rows = slice(begin, min(begin + _BLOCK, len(places)))
            block = _Block(np.clip(places[rows], 0.0, cells), cells, weights[rows])
            self._blocks.append((rows, block))

    def normal(self) -> Array:
        """Sums of weight b_i b_j over the samples, upper banded form, (DEGREE + 1, splines)."""
        found = np.zeros((_WIDTH, self._cells + DEGREE))
        for _, block in self._blocks:
            products = block.of_cells(
                block.weighted().swapaxes(0, 1) @ block.powers().transpose(1, 2, 0)
            )
            sums = product(_PAIRS, products.reshape(-1, _WIDTH * _WIDTH).T)
            for (p, q), row in zip(_UPPER, sums, strict=True):
                found[DEGREE - (q - p), block.own(q)] += row
        return found

    def projected(self, values: Array, chosen: NDArray[np.intp]) -> Array:
        """Sums of weight b_i y over the samples, y m rows of values; shape (splines, m)."""
        m = len(chosen)
        projected = np.zeros((self._cells + DEGREE, m))
        for rows, block in self._blocks:
            placed = block.placed(values[:, rows], chosen)
            moments = block.of_cells(block.weighted().swapaxes(0, 1) @ placed)
            sums = product(_PIECES, moments.swapaxes(0, 1).reshape(_WIDTH, -1))
            for p, of_cells in enumerate(sums.reshape(_WIDTH, -1, m)):
                projected[block.own(p)] += of_cells
        return projected

    def put(self, coefficients: Array, width: float, wanted: Wanted, rows: slice) -> None:
        """Derivatives of sums of splines at some samples.

        Args:
            coefficients: Shape (splines, m).
            width: Of a cell [s].
            wanted: See `spline_pieces.Wanted`.
            rows: The samples.
        """
        for part, block in self._blocks:
            own = slice(max(part.start, rows.start), min(part.stop, rows.stop))
            if own.start >= own.stop:
                continue
            into = slice(own.start - rows.start, own.stop - rows.start)
            inside = slice(own.start - part.start, own.stop - part.start)
            each = np.stack([coefficients[block.own(p)] for p in range(_WIDTH)])
            polynomials = product(_PIECES.T, each.reshape(_WIDTH, -1)).reshape(each.shape)
            polynomials, powers = block.of_rows(polynomials), block.powers()
            for order, columns, target, places in wanted:
                factors = np.array([math.perm(k, order) for k in range(order, _WIDTH)])
                factors = factors / width**order
                those = polynomials[order:, :, columns] * factors[:, None, None]
                found = block.values(those, powers[: _WIDTH - order])
                for column, place in zip(found, places, strict=True):
                    target[into, place] = block.taken(column, inside)


class _Block:
    """Samples in rows of one length; a row belongs to a cell, a cell may have several.

    Rows that are too long repeat the last sample of their cell, without weight.
    """

    def __init__(self, places: Array, cells: int, weights: Array) -> None:
        n = len(places)
        at = np.minimum(places.astype(np.intp), cells - 1)
        starts = np.flatnonzero(np.diff(at, prepend=-1))
        self._used = at[starts]  # cells that hold a sample
        ends = np.append(starts[1:], n)
        counts = ends - starts
        length = int(counts.max())
        if length * len(counts) > _LOOSE * n:
            length = max(n // len(counts), 1)
        self._of_cell = -(-counts // length)  # rows
        self._first = np.cumsum(self._of_cell) - self._of_cell
        self._places = np.repeat(self._first * length - starts, counts) + np.arange(n)
        self._several = int(self._of_cell.max()) > 1
        if self._several:
            steps = np.arange(int(self._of_cell.sum())) - np.repeat(self._first, self._of_cell)
            starts = np.repeat(starts, self._of_cell) + length * steps
            ends = np.repeat(ends, self._of_cell)
        samples = starts[:, None] + np.arange(length)
        is_sample = samples < ends[:, None]
        self._samples = np.minimum(samples, ends[:, None] - 1)
        first, last = int(self._used[0]), int(self._used[-1])
        self._span = slice(first, last + 1) if last - first + 1 == len(self._used) else None
        self._u = np.take(places - at - _MIDDLE, self._samples)
        self._weights = np.take(weights, self._samples) * is_sample

    def powers(self) -> Array:
        """Powers of u, shape (6, rows, length): cheaper to find again than to keep."""
        powers = np.empty((_WIDTH, *self._u.shape))
        powers[0] = 1.0
        for k in range(1, _WIDTH):
            np.multiply(powers[k - 1], self._u, out=powers[k])
        return powers

    def weighted(self) -> Array:
        """Powers times weights, the same shape."""
        weighted = np.empty((_WIDTH, *self._u.shape))
        weighted[0] = self._weights
        for k in range(1, _WIDTH):
            np.multiply(weighted[k - 1], self._u, out=weighted[k])
        return weighted

    def placed(self, values: Array, chosen: NDArray[np.intp]) -> Array:
        """Chosen rows of values of the samples, shape (k, n), as a view (rows, length, m)."""
        placed = np.empty((len(chosen), *self._samples.shape))
        for own, k in zip(placed, chosen, strict=True):
            np.take(values[k], self._samples, out=own, mode="clip")
        return placed.transpose(1, 2, 0)

    @staticmethod
    def values(polynomials: Array, powers: Array) -> Array:
        """Polynomials, shape (k, rows, m), in their places, shape (m, rows, length)."""
        values = np.empty((polynomials.shape[2], *powers.shape[1:]))
        of_rows = polynomials.transpose(1, 2, 0)
        np.matmul(of_rows, powers.swapaxes(0, 1), out=values.swapaxes(0, 1))
        return values

    def taken(self, placed: Array, samples: slice) -> Array:
        """Values in their places, shape (rows, length), of some samples."""
        return np.take(placed.reshape(-1), self._places[samples], mode="clip")

    def own(self, p: int) -> slice | NDArray[np.intp]:
        """The spline p of each cell."""
        span = self._span
        return self._used + p if span is None else slice(span.start + p, span.stop + p)

    def of_cells(self, sums: Array) -> Array:
        """Sums of rows, shape (rows, ..), to those of cells."""
        if not self._several:
            return sums
        of_cells: Array = np.add.reduceat(sums, self._first, axis=0)
        return of_cells

    def of_rows(self, polynomials: Array) -> Array:
        """Polynomials of cells, shape (6, cells, m), for each row."""
        return np.repeat(polynomials, self._of_cell, axis=1) if self._several else polynomials
