"""Quintic B-splines with uniform knots: sums over samples, and values at samples.

Within a cell the six splines are polynomials. Splines of pairs of cells are sums of splines of
the cells,

    b(x) = 2^-5 sum_k C(6, k) b(2 x - k), k = 0 .. 6

A row of samples lies in a few consecutive cells and involves only their splines, so sums and
values are small matrix products, one for each row. Samples are processed in blocks that fit into
the cache. With a million samples this takes half the time of `scipy.interpolate.BSpline`.

Source: C. de Boor, A Practical Guide to Splines, 1978, chapters IX (truncated powers) and XI
    (insertion of knots).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from mbd_ros.core.state import Array

_MOST = 1 << 18
DEGREE = 5
# Order of a derivative, columns of signals, target array, columns of the target.
Wanted = Sequence[tuple[int, NDArray[np.intp], Array, NDArray[np.intp]]]
_ENDS = -0.5, 0.5  # of a cell, which the middles of its halves are half as far from its middle as
_SHARES = [math.comb(DEGREE + 1, k) / 2.0**DEGREE for k in range(DEGREE + 2)]


def pieces(origin: float) -> Array:
    """Return the coefficients of u^k, k = 0 .. 5, of the six splines of a cell, (spline, k).

    b_p(u) = 1/5! sum_j (-1)^j C(6, j) (u + origin + 5 - p - j)^5 over the terms that are positive.

    Args:
        origin: Position of u = 0 in the cell, from 0 (begin) to 1 (end).
    """
    n, coefficients = DEGREE, np.zeros((DEGREE + 1, DEGREE + 1))
    for p in range(n + 1):
        for j in range(n + 1 - p):
            shift, sign = n - p - j, (-1.0) ** j * math.comb(n + 1, j) / math.factorial(n)
            for k in range(n + 1):
                coefficients[p, k] += sign * math.comb(n, k) * (shift + origin) ** (n - k)
    return coefficients


_AT_MIDDLE = pieces(0.5)[:, 0]  # values of the six splines of a cell in its middle
_WIDTH = DEGREE + 1  # splines that are not 0 in a cell
_LENGTH = 16  # samples of a row, about
_LOOSE = 2.0  # places that rows of one length may take, per sample
_BLOCK = 4096  # samples
_MIDDLE = 0.5
_PIECES = pieces(_MIDDLE)
_PAIRS = [(p, q) for p in range(_WIDTH) for q in range(p, _WIDTH)]
_PRODUCTS = np.array([np.convolve(_PIECES[p], _PIECES[q]) for p, q in _PAIRS])


class CellBasis:
    """Splines of uniform cells, evaluated at samples.

    Args:
        places: Increasing positions of the samples in units of a cell, shape (n,).
        cells: Number of cells; there are `cells + DEGREE` splines.
        weights: Weights of the samples, shape (n,).
    """

    def __init__(self, places: Array, cells: int, weights: Array) -> None:
        places = np.clip(places, 0.0, cells)
        self._cells, self._weights = cells, weights
        self._at = np.minimum(places.astype(np.intp), cells - 1)
        self._u = places - self._at - _MIDDLE
        self._several = max(_LENGTH * cells // len(places), 1)  # cells of a row
        self._groups = -(-cells // self._several)
        self._cached_blocks: list[tuple[slice, _Block]] = []
        self._sums: list[Array] = []
        self._normals: dict[int, Array] = {}

    def normal(self, level: int = 0) -> Array:
        """Return sums of weight b_i b_j over samples, upper banded form, (DEGREE + 1, splines).

        Args:
            level: Use cells 2^level times as wide; `cells` must be a multiple of 2^level.
        """
        if level not in self._normals:
            powers = self._powers(level)
            cells = powers.shape[1]
            band = np.zeros((_WIDTH, cells + DEGREE))
            for (p, q), row in zip(_PAIRS, product(_PRODUCTS, powers), strict=True):
                band[DEGREE - (q - p), q : q + cells] += row
            self._normals[level] = band
        return self._normals[level]

    def _powers(self, level: int) -> Array:
        """Return sums of weight u^k over samples of each cell, k = 0 .. 10, shape (11, cells)."""
        if not self._sums:
            self._sums.append(np.empty((2 * DEGREE + 1, self._cells)))
            weighted = self._weights.copy()
            for row in self._sums[0]:
                row[:] = np.bincount(self._at, weighted, self._cells)
                weighted *= self._u
        while len(self._sums) <= level:
            self._sums.append(join_power_sums(self._sums[-1]))
        return self._sums[level]

    def projected(self, values: Array, chosen: NDArray[np.intp]) -> Array:
        """Return sums of weight b_i y over samples for chosen columns y, shape (m, splines)."""
        several, columns = self._several, _as_slice(chosen)
        projected = np.zeros((self._groups * several + DEGREE, len(chosen)))
        for rows, block in self._blocks():
            sums = block.sums(self._weights[rows], values[rows][:, columns])
            for p in range(several + DEGREE):
                projected[block.spline_rows(p)] += sums[:, p]
        return np.ascontiguousarray(projected[: self._cells + DEGREE].T)

    def put(self, coefficients: Array, width: float, wanted: Wanted, rows: slice) -> None:
        """Write splines or their derivatives at some samples into target arrays.

        Args:
            coefficients: Coefficients of the splines, shape (m, splines).
            width: Width of a cell [s].
            wanted: Requested derivatives and their targets, see `Wanted`.
            rows: The samples.
        """
        orders = sorted({order for order, *_ in wanted})
        missing = self._groups * self._several - self._cells
        padded = np.pad(coefficients, ((0, 0), (0, missing)))
        for part, block in self._blocks():
            common = slice(max(part.start, rows.start), min(part.stop, rows.stop))
            if common.start >= common.stop:
                continue
            into = slice(common.start - rows.start, common.stop - rows.start)
            inside = slice(common.start - part.start, common.stop - part.start)
            values = block.values(padded, orders, width)
            for order, columns, target, places in wanted:
                at = block.places(orders.index(order), len(orders))[inside]
                target[into, _as_slice(places)] = np.take(
                    values[:, _as_slice(columns)], at, axis=0, mode="clip"
                )

    def _blocks(self) -> Iterator[tuple[slice, _Block]]:
        """Return the blocks of samples, which are built at the first call."""
        if not self._cached_blocks:
            for begin in range(0, len(self._u), _BLOCK):
                rows = slice(begin, begin + _BLOCK)
                block = _Block(self._at[rows], self._u[rows], self._several)
                self._cached_blocks.append((slice(begin, begin + len(block.u)), block))
        return iter(self._cached_blocks)


class _Block:
    """Samples in rows of equal length; a row covers some cells, which may have several rows.

    Attributes:
        u: Positions of the samples relative to the centre of their cell, shape (n,).
    """

    def __init__(self, at: NDArray[np.intp], u: Array, several: int) -> None:
        self.u, self._several, n = u, several, len(u)
        group, offset = np.divmod(at, several) if several > 1 else (at, np.zeros_like(at))
        self._offset: NDArray[np.intp] = offset
        starts = np.flatnonzero(np.diff(group, prepend=-1))
        self._used = group[starts]  # groups that hold a sample
        counts = np.diff(np.append(starts, n))
        length = int(counts.max())
        if length * len(counts) > _LOOSE * n:
            length = max(n // len(counts), 1)
        of_group = -(-counts // length)  # rows
        self._first = np.cumsum(of_group) - of_group
        self._rows, self._length = int(of_group.sum()), length
        self._long = self._rows > len(of_group)
        self._group = np.repeat(self._used, of_group) if self._long else self._used
        place = np.repeat(self._first * length - starts, counts) + np.arange(n)
        self._row, self._within = np.divmod(place, length)
        self._weighted: Array | None = None  # splines, kept for the next signals
        first, last = int(self._used[0]), int(self._used[-1])
        self._span = slice(first, last + 1) if last - first + 1 == len(self._used) else None

    def spline_rows(self, p: int) -> slice | NDArray[np.intp]:
        """Return the indices of spline p of each group of cells."""
        span, several = self._span, self._several
        if span is None:
            return self._used * several + p
        return slice(span.start * several + p, (span.stop - 1) * several + p + 1, several)

    def places(self, k: int, count: int) -> NDArray[np.intp]:
        """Return the indices of samples in the k-th part of rows with `count` parts."""
        places: NDArray[np.intp] = (self._row * count + k) * self._length + self._within
        return places

    def sums(self, weights: Array, values: Array) -> Array:
        """Return sums of weight b_p y for each group, shape (groups, splines, m)."""
        placed = np.zeros((self._rows * self._length, values.shape[1]))
        placed[self.places(0, 1)] = values
        by_row = placed.reshape(self._rows, self._length, -1)
        if self._weighted is None:
            self._weighted = self._splines([weights * self._polynomials(0, 1.0)])
        sums = self._weighted @ by_row
        return np.add.reduceat(sums, self._first, axis=0) if self._long else sums

    def values(self, coefficients: Array, orders: Sequence[int], width: float) -> Array:
        """Return derivatives of splines at the positions of `places`, shape (places, m)."""
        m, splines = len(coefficients), self._several + DEGREE
        per_signal, step = coefficients.strides
        shape, strides = (1 + int(self._group[-1]), splines, m), (step * self._several, step)
        every = as_strided(coefficients, shape, (*strides, per_signal), writeable=False)
        is_all = self._span is not None and not self._long
        by_row = every[self._span if is_all else self._group]
        basis = self._splines([self._polynomials(order, width) for order in orders])
        return (basis.swapaxes(1, 2) @ by_row).reshape(-1, m)

    def _polynomials(self, order: int, width: float) -> Array:
        """Return derivatives of the six splines of the cell of each sample, shape (6, n)."""
        factors = np.array([math.perm(k, order) for k in range(order, _WIDTH)])
        powers = np.empty((_WIDTH - order, len(self.u)))
        powers[0] = 1.0
        for k in range(1, len(powers)):
            np.multiply(powers[k - 1], self.u, out=powers[k])
        return product(_PIECES[:, order:] * (factors / width**order), powers)

    def _splines(self, each: Sequence[Array]) -> Array:
        """Arrange values of the six splines of each sample in rows.

        Args:
            each: Values of the six splines at the samples, shape (6, n) each.

        Returns:
            Shape (rows, splines, len(each) * length); 0 beside the six splines.
        """
        splines, long = self._several + DEGREE, len(each) * self._length
        arranged = np.zeros(self._rows * splines * long)
        base = (self._row * splines + self._offset) * long + self._within
        for k, values in enumerate(each):
            at = base + k * self._length
            for spline_values in values:
                arranged[at] = spline_values
                at += long
        return arranged.reshape(self._rows, splines, long)


def product(left: Array, right: Array) -> Array:
    """Return left @ right without threads of BLAS, for a long inner dimension or many columns.

    BLAS starts threads for a product of more than 2^18 multiplications, and their synchronization
    costs more than these products take on a single core.
    """
    (rows, inner), columns = left.shape, right.shape[1]
    if columns > inner:
        step = max(_MOST // (rows * inner), 1)
        parts = [left @ right[:, i : i + step] for i in range(0, columns, step)]
        return np.concatenate(parts, axis=1)
    step = max(_MOST // (rows * columns), 1)
    total: Array = np.zeros((rows, columns))
    for i in range(0, inner, step):
        total += left[:, i : i + step] @ right[i : i + step]
    return total


def join_power_sums(sums: Array) -> Array:
    """Return sums of y u^k for pairs of cells, with u relative to the centre of a cell.

    In a pair, u becomes (u -+ 1/2) / 2.

    Args:
        sums: Sums for an even number of cells, shape (k, cells).
    """
    joined: Array = np.zeros((len(sums), sums.shape[1] // 2))
    for half, end in enumerate(_ENDS):
        shares = [
            [math.comb(k, j) * end ** max(k - j, 0) / 2.0**k for j in range(len(sums))]
            for k in range(len(sums))
        ]
        joined += product(np.array(shares), sums[:, half::2])
    return joined


def _as_slice(chosen: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Return column indices as a slice if they are consecutive, so that indexing makes a view."""
    beside = bool((np.diff(chosen) == 1).all()) and len(chosen) > 0
    return slice(int(chosen[0]), int(chosen[-1]) + 1) if beside else chosen


def join_cells(sums: Array) -> Array:
    """Return the sums of b y for splines of pairs of cells.

    Args:
        sums: Sums for splines of an even number of cells, shape (m, splines).
    """
    splines = (sums.shape[1] - DEGREE) // 2 + DEGREE
    padded = np.pad(sums, ((0, 0), (DEGREE, DEGREE + 1)))
    joined: Array = np.zeros((len(sums), splines))
    for k, share in enumerate(_SHARES):
        joined += share * padded[:, k : k + 2 * splines : 2]
    return joined


def split_cells(coefficients: Array) -> Array:
    """Return the coefficients of the same function for splines of half cells.

    Args:
        coefficients: Coefficients for the splines of cells, shape (m, splines).
    """
    m, splines = coefficients.shape
    padded = np.zeros((m, 2 * splines + DEGREE + 1))
    for k, share in enumerate(_SHARES):
        padded[:, k : k + 2 * splines : 2] += share * coefficients
    return padded[:, DEGREE : 2 * splines]


def cell_centre_values(coefficients: Array) -> Array:
    """Return the values at the centre of each cell, shape (m, cells).

    Args:
        coefficients: Coefficients of the splines, shape (m, splines).
    """
    cells = coefficients.shape[1] - DEGREE
    values: Array = np.zeros((len(coefficients), cells))
    for p, share in enumerate(_AT_MIDDLE):
        values += share * coefficients[:, p : p + cells]
    return values
