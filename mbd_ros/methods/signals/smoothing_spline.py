"""Smoothing splines with a cut-off in Hz: a low-pass of a whole recording that does not lag.

The quintic spline s = sum_i c_i b_i that minimizes, over time and over the samples y,

    integral (s - y)^2 + (sqrt 2 - 1) (2 pi cutoff)^-8 (d^4 s / dt^4)^2 dt

passes 1 / (1 + (sqrt 2 - 1) (f / cutoff)^8) of a sine. Knots are uniform, and the fourth
derivative is taken as a difference of coefficients: these solve (N + stiffness D' D) c = b, whose
matrix is a band.

Sources: P. H. C. Eilers, B. D. Marx, Stat. Sci. 11, 1996, 89 (penalty on differences);
    P. Craven, G. Wahba, Numer. Math. 31, 1979, 377 (smoothing splines as low-pass).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.methods.signals.spline_basis import DEGREE, CellBasis, Wanted, joined, middles, parted

ORDER = 4  # of the derivative that is kept small
_HOLD = 1.0e-12  # share by which the main diagonal grows where rounding took its rank
_DIFFERENCE = [math.comb(ORDER, j) * (-1.0) ** j for j in range(ORDER + 1)]
CELLS = 8  # polynomial pieces a period of a cut-off at least
FLATTEST = 0.01  # periods of a cut-off in the recording: a cubic is all that is left by then
_LEVELS = 3  # octaves of cut-offs for which samples are looked at once
_MORE = 1.05  # times the cells that there have to be
_ROUNDING = 1.0e-9  # of an octave
FEWEST = 6  # samples in a row: a quintic through them
HIGHEST = 0.4  # cut-off per sampling rate beyond which nothing is left to smooth
PERIODS = 14  # of the cut-off until the end of a window is forgotten: exp(-2.7 PERIODS)
_SPREAD = 64  # cells of the recording at least, in the middle of which signals are looked at
HALF_POWER = np.sqrt(2.0) - 1.0


class LowPass:
    """What passes signals below cut-offs of their own.

    The spline passes `response` without lag, at any rate and with irregular stamps; where a sine
    ends with the recording, or in a gap, it continues as the cubic that fits best. Cells of a low
    cut-off are those of a higher one, joined: samples are looked at once for all that are not far
    apart.

    Args:
        times: [s], increasing, at least `FEWEST`, shape (n,).
        cutoffs: Frequencies of half power that will be asked for [Hz].
        whole: What the samples are a window of; without it they are the whole. `PERIODS` of the
            cut-off from the ends of a window the result is that of the whole, to rounding.
    """

    def __init__(self, times: Array, cutoffs: Array, whole: Stretch | None = None) -> None:
        self._times, self._whole = times, whole or Stretch.of(times)
        self._span = self._whole.end - self._whole.begin
        smooth = cutoffs[cutoffs < HIGHEST * self._whole.rate]
        self._grids = grids_of(sorted(set(smooth.tolist()), reverse=True), self._span)
        self._bases: dict[int, CellBasis] = {}
        self._equations: dict[float, SmoothingEquations] = {}

    def put(
        self,
        values: Array,
        chosen: NDArray[np.intp],
        cutoff: Array,
        wanted: Wanted,
        rows: slice,
    ) -> None:
        """Put derivatives of passed signals where they are wanted.

        Args:
            values: Signals, one a column, shape (n, k).
            chosen: Those that pass, shape (m,).
            cutoff: That of each that passes, shape (m,); from `HIGHEST` times the rate on the
                spline passes through the samples.
            wanted: See `Wanted`; orders are 0, 1 or 2.
            rows: The samples that are wanted.
        """
        exact = np.flatnonzero(cutoff >= HIGHEST * self._whole.rate)
        if len(exact):
            self._through(values[:, chosen[exact]], _of(wanted, exact), rows)
        for grid, own in self._families(cutoff):
            coefficients = self._coefficients(grid, values, chosen[own], cutoff[own], True)
            width = self._span / grid.cells
            self._basis(grid).put(coefficients, width, _of(wanted, own), rows)

    def spread(
        self,
        values: Array,
        chosen: NDArray[np.intp],
        cutoff: Array,
        rows: slice,
    ) -> Iterator[tuple[NDArray[np.intp], Array, float]]:
        """Passed signals at evenly spread times, those of like cut-offs together.

        Args:
            values: Signals, one a column, shape (n, k).
            chosen: Those that pass, shape (m,).
            cutoff: As that of `put`.
            rows: The samples between which the times are.

        Yields:
            Places of signals in `chosen`, their values, shape (times, ..), and the step [s]. Where
            nothing is smoothed these are the samples.
        """
        begin, end = self._times[rows][[0, -1]] - self._whole.begin
        exact = np.flatnonzero(cutoff >= HIGHEST * self._whole.rate)
        if len(exact):
            yield exact, values[rows, chosen[exact]], self._whole.usual
        for grid, own in self._families(cutoff):
            coefficients = self._coefficients(grid, values, chosen[own], cutoff[own], False)
            cells, first = grid.cells, self._begin(grid)[0]
            while cells < _SPREAD:
                coefficients, cells, first = parted(coefficients), 2 * cells, 2 * first
            at = np.rint(np.array([begin, end]) * (cells / self._span)).astype(np.intp) - first
            inside = coefficients[:, at[0] : at[1] + DEGREE]
            yield own, middles(inside).T, self._span / cells

    def _through(self, values: Array, wanted: Wanted, rows: slice) -> None:
        from scipy.interpolate import make_interp_spline  # only where nothing is smoothed

        through = make_interp_spline(self._times, values, k=DEGREE, axis=0)
        for order, columns, target, places in wanted:
            target[:, places] = through(self._times[rows], nu=order)[:, columns]

    def _families(self, cutoff: Array) -> Iterator[tuple[Grid, NDArray[np.intp]]]:
        """Signals that are looked at together, and a grid of their finest cells."""
        grids = [self._grids.get(f) for f in cutoff.tolist()]
        cells = np.array([grid.cells if grid else 0 for grid in grids])
        for one in {grid.cells: grid for grid in grids if grid}.values():
            yield one, np.flatnonzero(cells == one.cells)

    def _begin(self, grid: Grid) -> tuple[int, int]:
        """First cell of the window, and their number: joined cells begin and end there, too."""
        begin, end = (self._times[[0, -1]] - self._whole.begin) * (grid.cells / self._span)
        first = min(int(begin), grid.cells - 1) // grid.unit * grid.unit
        last = -(-min(math.ceil(end), grid.cells) // grid.unit) * grid.unit
        return first, max(last - first, grid.unit)

    def _basis(self, grid: Grid) -> CellBasis:
        """Splines at the samples of the window."""
        if grid.cells not in self._bases:
            first, count = self._begin(grid)
            places = (self._times - self._whole.begin) * (grid.cells / self._span) - first
            weights = np.minimum(np.gradient(self._times), 4.0 * self._whole.usual)
            self._bases[grid.cells] = CellBasis(places, count, weights)
        return self._bases[grid.cells]

    def _coefficients(
        self, grid: Grid, values: Array, chosen: NDArray[np.intp], cutoff: Array, refine: bool
    ) -> Array:
        """Of the splines of the finest cells, for signals that pass; shape (m, splines)."""
        found = self._basis(grid).projected(values, chosen)
        for f in np.unique(cutoff).tolist():
            own, level = np.flatnonzero(cutoff == f), self._grids[f].level
            known, refined = found[own], refine and self._grids[f].is_fine
            for _ in range(level):
                known = joined(known)
            solved = self._equations_of(f).solve(known, refined)
            for _ in range(level):
                solved = parted(solved)
            found[own] = solved
        return found

    def _equations_of(self, cutoff: float) -> SmoothingEquations:
        if cutoff not in self._equations:
            grid = self._grids[cutoff]
            width = self._span / (grid.cells >> grid.level)
            turn = 2.0 * np.pi * max(cutoff, FLATTEST / self._span)
            stiffness = HALF_POWER * (turn * width) ** (-2 * ORDER) * width
            normal = self._basis(grid).normal(grid.level)
            self._equations[cutoff] = SmoothingEquations(normal, stiffness)
        return self._equations[cutoff]


def grids_of(cutoffs: Sequence[float], span: float) -> dict[float, Grid]:
    """Those of cut-offs from the highest on [Hz], in a recording of so many seconds."""
    found: dict[float, Grid] = {}
    periods = {f: max(f * span, FLATTEST) for f in cutoffs}
    while periods:
        top = max(periods.values())
        levels = {f: int(math.log2(top / n) + _ROUNDING) for f, n in periods.items()}
        own = {f: level for f, level in levels.items() if level <= _LEVELS}
        unit = 2 ** max(own.values())
        cells = math.ceil(top * CELLS / unit) * unit
        for f, level in own.items():
            is_fine = cells >> level > _MORE * CELLS * periods[f] + 1.0
            found[f] = Grid(cells, unit, level, is_fine)
        periods = {f: n for f, n in periods.items() if f not in own}
    return found


class Grid(NamedTuple):
    """Cells of a recording for a cut-off.

    Attributes:
        cells: Of the highest cut-off that is looked at together with this one.
        unit: Of these, as many as there are in one of the lowest.
        level: This one has cells 2^level times as wide.
        is_fine: Whether these are narrower than they have to be, so that equations are stiffer.
    """

    cells: int
    unit: int
    level: int
    is_fine: bool


class SmoothingEquations:
    """Equations (N + stiffness D' D) c = b of a smoothing spline, prepared for several b.

    N are sums of products of splines over samples, D the fourth differences of coefficients.

    Args:
        normal: N in upper banded form, shape (DEGREE + 1, n).
        stiffness: That of the differences, > 0.
    """

    def __init__(self, normal: Array, stiffness: float) -> None:
        from scipy.linalg import cholesky_banded  # only where a recording is smoothed

        self._normal, self._stiffness = normal, stiffness
        band = normal.copy()
        for k, diagonal in enumerate(_penalty(band.shape[1])):
            band[DEGREE - k, k:] += stiffness * diagonal
        try:
            self._factor: Array = cholesky_banded(band)
        except np.linalg.LinAlgError:  # a wide gap of many cells: only the penalty holds them
            band[DEGREE] *= 1.0 + _HOLD
            self._factor = cholesky_banded(band)

    def solve(self, known: Array, refined: bool = False) -> Array:
        """Solution for b of shape (m, n), same shape.

        Args:
            refined: Take what is left of b as another b. Differences of smooth coefficients are
                small and known well, a row of D' D times them is not: what stiff equations lose
                to rounding comes back.
        """
        from scipy.linalg import cho_solve_banded

        factor = self._factor, False
        found: Array = cho_solve_banded(factor, known.T, check_finite=False).T
        if refined:
            left = self._left(known, found)
            found = found + cho_solve_banded(factor, left.T, check_finite=False).T
        return found

    def _left(self, known: Array, found: Array) -> Array:
        """What is left of b."""
        left = known - self._normal[DEGREE] * found
        for k in range(1, min(DEGREE, found.shape[1] - 1) + 1):
            diagonal = self._normal[DEGREE - k, k:]
            left[:, :-k] -= diagonal * found[:, k:]
            left[:, k:] -= diagonal * found[:, :-k]
        pulls, n = self._stiffness * np.diff(found, ORDER, axis=1), found.shape[1] - ORDER
        for j, share in enumerate(_DIFFERENCE):
            left[:, j : j + n] -= share * pulls
        return left


def _penalty(size: int) -> list[Array]:
    """Diagonals, from the main one up, of the squares of fourth differences of `size` numbers."""
    row = _DIFFERENCE
    diagonals = []
    for k in range(min(ORDER + 1, size)):
        diagonal = np.zeros(size - k)
        for j in range(ORDER + 1 - k):
            diagonal[j : j + size - ORDER] += row[j] * row[j + k]
        diagonals.append(diagonal)
    return diagonals


def _of(wanted: Wanted, signals: NDArray[np.intp]) -> Wanted:
    """What is wanted of some signals, by their place among these."""
    found = []
    for order, columns, target, places in wanted:
        own = np.isin(columns, signals)
        if own.any():
            found.append((order, np.searchsorted(signals, columns[own]), target, places[own]))
    return found


class Stretch(NamedTuple):
    """A recording without gaps, of which signals are a window.

    Attributes:
        begin: Of its first sample [s].
        end: Of its last one [s].
        usual: Median of the steps around each sample [s].
        rate: Usual number of samples a second [Hz].
    """

    begin: float
    end: float
    usual: float
    rate: float

    @classmethod
    def of(cls, times: Array, *more: Array) -> Stretch:
        """That of its times [s], of pieces that tell it, the first and the last of them among."""
        pieces = times, *more
        usual = float(np.median(np.concatenate([np.gradient(piece) for piece in pieces])))
        steps = np.concatenate([np.diff(piece) for piece in pieces])
        return cls(float(times[0]), float(pieces[-1][-1]), usual, 1.0 / float(np.median(steps)))


def response(frequency: Array, cutoff: float) -> Array:
    """Share of a sine that passes: 1 / (1 + (sqrt 2 - 1) (f / cutoff)^8).

    Args:
        frequency: f [Hz].
        cutoff: Frequency of half power [Hz].
    """
    squared = np.square(frequency / cutoff)
    passed: Array = 1.0 / (1.0 + HALF_POWER * np.square(np.square(squared)))
    return passed


def rate_of(times: Array) -> float:
    """Usual number of samples a second [Hz]."""
    return 1.0 / float(np.median(np.diff(times)))
