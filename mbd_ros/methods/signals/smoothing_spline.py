"""Smoothing splines with a cut-off frequency: a low-pass of a recording without lag.

The quintic spline s = sum_i c_i b_i that minimizes, over time and over the samples y,

    integral (s - y)^2 + (sqrt 2 - 1) (2 pi cutoff)^-8 (d^4 s / dt^4)^2 dt

reduces a sine of frequency f to 1 / (1 + (sqrt 2 - 1) (f / cutoff)^8) of its amplitude. Knots are
uniform, and the fourth derivative is taken as a difference of coefficients: these solve (N +
stiffness D' D) c = b, whose matrix is a band.

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
from mbd_ros.methods.signals.spline_basis import (
    DEGREE,
    CellBasis,
    Wanted,
    cell_centre_values,
    join_cells,
    split_cells,
)

ORDER = 4  # of the penalized derivative
_REGULARIZATION = 1.0e-12  # relative increase of the main diagonal if it is singular to rounding
_DIFFERENCE = [math.comb(ORDER, j) * (-1.0) ** j for j in range(ORDER + 1)]
CELLS = 8  # least number of polynomial pieces for each period of a cut-off
FLATTEST = 0.01  # periods of a cut-off in the recording below which only a cubic remains
_LEVELS = 3  # octaves of cut-offs that share the sums over samples
_MORE = 1.05  # ratio to the necessary number of cells above which equations are refined
_ROUNDING = 1.0e-9  # of an octave
FEWEST = 6  # least number of samples, which a quintic interpolates
HIGHEST = 0.4  # cut-off relative to the sampling rate beyond which nothing is smoothed
PERIODS = 14  # of the cut-off after which the end of a window has no effect: exp(-2.7 PERIODS)
_SPREAD = 64  # least number of cells of a recording at which `spread` evaluates signals
HALF_POWER = np.sqrt(2.0) - 1.0


class LowPass:
    """Zero-phase low-pass of signals with individual cut-off frequencies.

    The spline has the frequency response `response` without lag, at any rate and with irregular
    stamps. At the ends of the recording and in gaps it continues as the best-fitting cubic. Cells
    of a low cut-off are unions of cells of a higher one, so that similar cut-offs share the sums
    over samples.

    Args:
        times: Increasing sample times [s], at least `FEWEST`, shape (n,).
        cutoffs: Frequencies of half power that will be used [Hz].
        recording: The recording of which the samples are a window; by default they are the
            complete recording. `PERIODS` of the cut-off away from the ends of a window the result
            equals that of the complete recording to rounding.
    """

    def __init__(self, times: Array, cutoffs: Array, recording: Stretch | None = None) -> None:
        self._times = times
        self._recording = recording or Stretch.of(times)
        self._span = self._recording.end - self._recording.begin
        smooth = cutoffs[cutoffs < HIGHEST * self._recording.rate]
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
        """Write filtered signals and their derivatives into target arrays.

        Args:
            values: Signals, one a column, shape (n, k).
            chosen: Columns to filter, shape (m,).
            cutoff: Cut-off of each [Hz], shape (m,); from `HIGHEST` times the rate on, the spline
                interpolates the samples.
            wanted: Requested derivatives and their targets, see `Wanted`; orders are 0, 1 or 2.
            rows: Samples at which they are evaluated.
        """
        exact = np.flatnonzero(cutoff >= HIGHEST * self._recording.rate)
        if len(exact):
            self._interpolate(values[:, chosen[exact]], _select(wanted, exact), rows)
        for grid, group in self._families(cutoff):
            coefficients = self._coefficients(grid, values, chosen[group], cutoff[group], True)
            width = self._span / grid.cells
            self._basis(grid).put(coefficients, width, _select(wanted, group), rows)

    def spread(
        self,
        values: Array,
        chosen: NDArray[np.intp],
        cutoff: Array,
        rows: slice,
    ) -> Iterator[tuple[NDArray[np.intp], Array, float]]:
        """Yield filtered signals at equidistant times, in groups of similar cut-offs.

        Args:
            values: Signals, one a column, shape (n, k).
            chosen: Columns to filter, shape (m,).
            cutoff: Cut-off of each [Hz], shape (m,).
            rows: Samples between which the times lie.

        Yields:
            Indices of signals in `chosen`, their values, shape (times, ..), and the step [s];
            where nothing is smoothed, the values of the samples.
        """
        begin, end = self._times[rows][[0, -1]] - self._recording.begin
        exact = np.flatnonzero(cutoff >= HIGHEST * self._recording.rate)
        if len(exact):
            yield exact, values[rows, chosen[exact]], self._recording.usual
        for grid, group in self._families(cutoff):
            coefficients = self._coefficients(grid, values, chosen[group], cutoff[group], False)
            cells, first = grid.cells, self._begin(grid)[0]
            while cells < _SPREAD:
                coefficients, cells, first = split_cells(coefficients), 2 * cells, 2 * first
            at = np.rint(np.array([begin, end]) * (cells / self._span)).astype(np.intp) - first
            inside = coefficients[:, at[0] : at[1] + DEGREE]
            yield group, cell_centre_values(inside).T, self._span / cells

    def _interpolate(self, values: Array, wanted: Wanted, rows: slice) -> None:
        from scipy.interpolate import make_interp_spline  # only where nothing is smoothed

        spline = make_interp_spline(self._times, values, k=DEGREE, axis=0)
        for order, columns, target, places in wanted:
            target[:, places] = spline(self._times[rows], nu=order)[:, columns]

    def _families(self, cutoff: Array) -> Iterator[tuple[Grid, NDArray[np.intp]]]:
        """Yield groups of signals with the same finest cells, and a grid of these cells."""
        grids = [self._grids.get(f) for f in cutoff.tolist()]
        cells = np.array([grid.cells if grid else 0 for grid in grids])
        for grid in {grid.cells: grid for grid in grids if grid}.values():
            yield grid, np.flatnonzero(cells == grid.cells)

    def _begin(self, grid: Grid) -> tuple[int, int]:
        """Return the first cell of the window and the number of its cells, in whole units."""
        begin, end = (self._times[[0, -1]] - self._recording.begin) * (grid.cells / self._span)
        first = min(int(begin), grid.cells - 1) // grid.unit * grid.unit
        last = -(-min(math.ceil(end), grid.cells) // grid.unit) * grid.unit
        return first, max(last - first, grid.unit)

    def _basis(self, grid: Grid) -> CellBasis:
        """Return the splines at the samples of the window."""
        if grid.cells not in self._bases:
            first, count = self._begin(grid)
            places = (self._times - self._recording.begin) * (grid.cells / self._span) - first
            weights = np.minimum(np.gradient(self._times), 4.0 * self._recording.usual)
            self._bases[grid.cells] = CellBasis(places, count, weights)
        return self._bases[grid.cells]

    def _coefficients(
        self, grid: Grid, values: Array, chosen: NDArray[np.intp], cutoff: Array, refine: bool
    ) -> Array:
        """Return coefficients of the splines of the finest cells, shape (m, splines)."""
        coefficients = self._basis(grid).projected(values, chosen)
        for f in np.unique(cutoff).tolist():
            group, level = np.flatnonzero(cutoff == f), self._grids[f].level
            sums, refined = coefficients[group], refine and self._grids[f].is_fine
            for _ in range(level):
                sums = join_cells(sums)
            solution = self._equations_of(f).solve(sums, refined)
            for _ in range(level):
                solution = split_cells(solution)
            coefficients[group] = solution
        return coefficients

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
    """Return grids of cut-offs [Hz], from the highest on, in a recording of a span [s]."""
    grids: dict[float, Grid] = {}
    periods = {f: max(f * span, FLATTEST) for f in cutoffs}
    while periods:
        top = max(periods.values())
        levels = {f: int(math.log2(top / n) + _ROUNDING) for f, n in periods.items()}
        group = {f: level for f, level in levels.items() if level <= _LEVELS}
        unit = 2 ** max(group.values())
        cells = math.ceil(top * CELLS / unit) * unit
        for f, level in group.items():
            is_fine = cells >> level > _MORE * CELLS * periods[f] + 1.0
            grids[f] = Grid(cells, unit, level, is_fine)
        periods = {f: n for f, n in periods.items() if f not in group}
    return grids


class Grid(NamedTuple):
    """Cells of a recording for a cut-off.

    Attributes:
        cells: Number of cells of the highest cut-off in the same group.
        unit: Number of these cells in one cell of the lowest cut-off of the group.
        level: Cells of this cut-off are 2^level times as wide.
        is_fine: Whether its cells are narrower than necessary, which makes its equations stiffer.
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
        stiffness: Weight of the differences, > 0.
    """

    def __init__(self, normal: Array, stiffness: float) -> None:
        from scipy.linalg import cholesky_banded  # only where a recording is smoothed

        self._normal, self._stiffness = normal, stiffness
        band = normal.copy()
        for k, diagonal in enumerate(_penalty(band.shape[1])):
            band[DEGREE - k, k:] += stiffness * diagonal
        try:
            self._factor: Array = cholesky_banded(band)
        except np.linalg.LinAlgError:  # many cells in a gap, which only the penalty determines
            band[DEGREE] *= 1.0 + _REGULARIZATION
            self._factor = cholesky_banded(band)

    def solve(self, b: Array, refined: bool = False) -> Array:
        """Solve for right-hand sides of shape (m, n), same shape.

        Args:
            b: Right-hand sides.
            refined: Whether to refine the solution once with its residual. The residual is
                computed with differences of coefficients, which are accurate; this restores the
                digits that stiff equations lose to rounding.
        """
        from scipy.linalg import cho_solve_banded

        factor = self._factor, False
        c: Array = cho_solve_banded(factor, b.T, check_finite=False).T
        if refined:
            residual = self._residual(b, c)
            c = c + cho_solve_banded(factor, residual.T, check_finite=False).T
        return c

    def _residual(self, b: Array, c: Array) -> Array:
        """Return b - (N + stiffness D' D) c."""
        residual = b - self._normal[DEGREE] * c
        for k in range(1, min(DEGREE, c.shape[1] - 1) + 1):
            diagonal = self._normal[DEGREE - k, k:]
            residual[:, :-k] -= diagonal * c[:, k:]
            residual[:, k:] -= diagonal * c[:, :-k]
        forces, n = self._stiffness * np.diff(c, ORDER, axis=1), c.shape[1] - ORDER
        for j, share in enumerate(_DIFFERENCE):
            residual[:, j : j + n] -= share * forces
        return residual


def _penalty(size: int) -> list[Array]:
    """Return the diagonals of D' D of `size` coefficients, from the main one up."""
    row = _DIFFERENCE
    diagonals = []
    for k in range(min(ORDER + 1, size)):
        diagonal = np.zeros(size - k)
        for j in range(ORDER + 1 - k):
            diagonal[j : j + size - ORDER] += row[j] * row[j + k]
        diagonals.append(diagonal)
    return diagonals


def _select(wanted: Wanted, signals: NDArray[np.intp]) -> Wanted:
    """Return the requests for some signals, with their indices among these."""
    selected = []
    for order, columns, target, places in wanted:
        chosen = np.isin(columns, signals)
        if chosen.any():
            at = np.searchsorted(signals, columns[chosen])
            selected.append((order, at, target, places[chosen]))
    return selected


class Stretch(NamedTuple):
    """Time span and sampling rate of a recording without gaps.

    Attributes:
        begin: Time of its first sample [s].
        end: Time of its last sample [s].
        usual: Median of the steps around each sample [s].
        rate: Median sampling rate [Hz].
    """

    begin: float
    end: float
    usual: float
    rate: float

    @classmethod
    def of(cls, times: Array, *more: Array) -> Stretch:
        """Return the stretch of sample times [s], or of pieces that include the first and last."""
        pieces = times, *more
        usual = float(np.median(np.concatenate([np.gradient(piece) for piece in pieces])))
        steps = np.concatenate([np.diff(piece) for piece in pieces])
        return cls(float(times[0]), float(pieces[-1][-1]), usual, 1.0 / float(np.median(steps)))


def response(frequency: Array, cutoff: float) -> Array:
    """Return the frequency response 1 / (1 + (sqrt 2 - 1) (f / cutoff)^8).

    Args:
        frequency: Frequency f [Hz].
        cutoff: Frequency of half power [Hz].
    """
    squared = np.square(frequency / cutoff)
    passed: Array = 1.0 / (1.0 + HALF_POWER * np.square(np.square(squared)))
    return passed


def rate_of(times: Array) -> float:
    """Return the median sampling rate [Hz]."""
    return 1.0 / float(np.median(np.diff(times)))
