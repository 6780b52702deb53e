"""Low-pass of a whole recording that does not lag: smoothing splines with a cut-off in Hz."""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.jobs.inverse.banded import Banded
from mbd_ros.jobs.inverse.cell_basis import CellBasis
from mbd_ros.jobs.inverse.spline_pieces import DEGREE, Wanted

FEWEST = 6  # samples in a row: a quintic through them
HIGHEST = 0.4  # cut-off per sampling rate beyond which nothing is left to smooth
PERIODS = 14  # of the cut-off until the end of a window is forgotten: exp(-2.7 PERIODS)
_ORDER = 4  # of the derivative that is kept small
_CELLS = 8  # polynomial pieces a period of the cut-off
_HOLD = 1.0e-12  # share by which the main diagonal grows where rounding took its rank
_SEVERAL = 4  # samples a cell, from which on sums go cell by cell
_HALF_POWER = np.sqrt(2.0) - 1.0
_FLATTEST = 0.01  # periods of the cut-off in the recording: a cubic is all that is left by then


def response(frequency: Array, cutoff: float) -> Array:
    """Share of a sine that passes: 1 / (1 + (sqrt 2 - 1) (f / cutoff)^8).

    Args:
        frequency: f [Hz].
        cutoff: Frequency of half power [Hz].
    """
    squared = np.square(frequency / cutoff)
    passed: Array = 1.0 / (1.0 + _HALF_POWER * np.square(np.square(squared)))
    return passed


def rate_of(times: Array) -> float:
    """Usual number of samples a second [Hz]."""
    return 1.0 / float(np.median(np.diff(times)))


Solve = Callable[[Array], Array]


class Basis(Protocol):
    """Splines at samples, see `UniformBasis`."""

    def normal(self) -> Array:
        """Sums of weight b_i b_j."""
        ...

    def projected(self, values: Array, chosen: NDArray[np.intp], /) -> Array:
        """Sums of weight b_i y."""
        ...

    def put(self, coefficients: Array, width: float, wanted: Wanted, rows: slice, /) -> None:
        """Derivatives of sums of splines."""
        ...


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
    def of(cls, times: Array, *more: Array) -> "Stretch":
        """That of its times [s], of pieces that tell it, the first and the last of them among."""
        pieces = times, *more
        usual = float(np.median(np.concatenate([np.gradient(piece) for piece in pieces])))
        steps = np.concatenate([np.diff(piece) for piece in pieces])
        return cls(float(times[0]), float(pieces[-1][-1]), usual, 1.0 / float(np.median(steps)))


class LowPass:
    """What passes signals below a cut-off.

    The quintic spline s that minimizes, over time and over the samples y,

        integral (s - y)^2 + (sqrt 2 - 1) (2 pi cutoff)^-8 (d^4 s / dt^4)^2 dt

    passes `response` without lag, at any rate and with irregular stamps; where a sine ends with
    the recording, or in a gap, it continues as the cubic that fits best.

    Args:
        times: [s], increasing, at least `FEWEST`, shape (n,).
        cutoff: Frequency of half power [Hz]; from `HIGHEST` times the rate on the spline passes
            through the samples.
        whole: What the samples are a window of; without it they are the whole. `PERIODS` of the
            cut-off from the ends of a window the result is that of the whole, to rounding.

    Source: P. H. C. Eilers, B. D. Marx, Stat. Sci. 11, 1996, 89 (penalty on differences);
        P. Craven, G. Wahba, Numer. Math. 31, 1979, 377 (smoothing splines as low-pass).
    """

    def __init__(self, times: Array, cutoff: float, whole: Stretch | None = None) -> None:
        whole = whole or Stretch.of(times)
        self._times, self._basis = times, None
        if cutoff >= HIGHEST * whole.rate:
            return
        span = whole.end - whole.begin
        cutoff = max(cutoff, _FLATTEST / span)
        most = max(int(np.ceil(span * _CELLS * cutoff)), 1)
        self._width = width = span / most
        places = (times - whole.begin) / width
        first = min(int(places[0]), most - 1)
        cells = max(min(math.ceil(places[-1]), most) - first, 1)
        weights = np.minimum(np.gradient(times), 4.0 * whole.usual)
        self._basis, prepare = _tools(places - first, cells, weights)
        penalty = _HALF_POWER * (2.0 * np.pi * cutoff * width) ** (-2 * _ORDER) * width
        normal = self._basis.normal()
        for k, diagonal in enumerate(_penalty(cells + DEGREE)):
            normal[DEGREE - k, k:] += penalty * diagonal
        try:
            self._solve = prepare(normal)
        except np.linalg.LinAlgError:  # a wide gap of many cells: only the penalty holds them
            normal[DEGREE] *= 1.0 + _HOLD
            self._solve = prepare(normal)

    def put(self, values: Array, chosen: NDArray[np.intp], wanted: Wanted, rows: slice) -> None:
        """Put derivatives of passed signals where they are wanted.

        Args:
            values: Signals, one a row, shape (k, n).
            chosen: Those that pass, shape (m,).
            wanted: See `spline_pieces.Wanted`; orders are 0, 1 or 2.
            rows: The samples that are wanted.
        """
        if self._basis is None:
            from scipy.interpolate import make_interp_spline  # only where nothing is smoothed

            through = make_interp_spline(self._times, values[chosen].T, k=DEGREE, axis=0)
            for order, own, target, places in wanted:
                target[:, places] = through(self._times[rows], nu=order)[:, own]
            return
        coefficients = self._solve(self._basis.projected(values, chosen))
        self._basis.put(coefficients, self._width, wanted, rows)


def _tools(places: Array, cells: int, weights: Array) -> tuple[Basis, Callable[[Array], Solve]]:
    """Splines at places [cells], and what prepares their banded equations."""
    if _SEVERAL * cells <= len(places):
        return CellBasis(places, cells, weights), lambda normal: Banded(normal).solve
    from scipy.linalg import cho_solve_banded, cholesky_banded  # its time counts little here

    from mbd_ros.jobs.inverse.uniform_basis import UniformBasis

    def prepare(normal: Array) -> Solve:
        factor = cholesky_banded(normal)
        return lambda known: np.asarray(cho_solve_banded((factor, False), known))

    return UniformBasis(places, cells, weights), prepare


def _penalty(size: int) -> list[Array]:
    """Diagonals, from the main one up, of the squares of fourth differences of `size` numbers."""
    row = np.array([math.comb(_ORDER, j) * (-1.0) ** j for j in range(_ORDER + 1)])
    diagonals = []
    for k in range(min(_ORDER + 1, size)):
        diagonal = np.zeros(size - k)
        for j in range(_ORDER + 1 - k):
            diagonal[j : j + size - _ORDER] += row[j] * row[j + k]
        diagonals.append(diagonal)
    return diagonals
