"""Low-pass of a whole recording that does not lag: smoothing splines with a cut-off in Hz."""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import solveh_banded

from mbd_ros.core.state import Array

FEWEST = 6  # samples in a row: a quintic through them
HIGHEST = 0.4  # cut-off per sampling rate beyond which nothing is left to smooth
_DEGREE, _ORDER = 5, 4  # of the pieces; of the derivative that is kept small
_CELLS = 8  # polynomial pieces a period of the cut-off
_HALF_POWER = np.sqrt(2.0) - 1.0
_FLATTEST = 0.01  # periods of the cut-off in the recording: a cubic is all that is left by then


def response(frequency: Array, cutoff: float) -> Array:
    """Share of a sine that passes: 1 / (1 + (sqrt 2 - 1) (f / cutoff)^8).

    Args:
        frequency: f [Hz].
        cutoff: Frequency of half power [Hz].
    """
    passed: Array = 1.0 / (1.0 + _HALF_POWER * (frequency / cutoff) ** (2 * _ORDER))
    return passed


def rate_of(times: Array) -> float:
    """Usual number of samples a second [Hz]."""
    return 1.0 / float(np.median(np.diff(times)))


def low_pass(times: Array, values: Array, cutoff: float, orders: Sequence[int]) -> list[Array]:
    """Signals below the cut-off, and their derivatives.

    The quintic spline s that minimizes, over time and over the samples y,

        integral (s - y)^2 + (sqrt 2 - 1) (2 pi cutoff)^-8 (d^4 s / dt^4)^2 dt

    passes `response` without lag, at any rate and with irregular stamps; where a sine ends with
    the recording, or in a gap, it continues as the cubic that fits best.

    Args:
        times: [s], increasing, at least `FEWEST`, shape (n,).
        values: Shape (n, m).
        cutoff: Frequency of half power [Hz]; from `HIGHEST` times the rate on the spline passes
            through the samples.
        orders: Derivatives wanted, up to 2.

    Returns:
        An array of the shape of `values` for each of `orders`.

    Source: P. H. C. Eilers, B. D. Marx, Stat. Sci. 11, 1996, 89 (penalty on differences);
        P. Craven, G. Wahba, Numer. Math. 31, 1979, 377 (smoothing splines as low-pass).
    """
    if cutoff >= HIGHEST * rate_of(times):
        return _at(make_interp_spline(times, values, k=_DEGREE, axis=0), times, orders)
    span = float(times[-1] - times[0])
    cutoff = max(cutoff, _FLATTEST / span)
    cells = max(int(np.ceil(span * _CELLS * cutoff)), 1)
    width, size = span / cells, cells + _DEGREE
    knots = times[0] + width * np.arange(-_DEGREE, cells + _DEGREE + 1)
    inside = np.clip(times, knots[_DEGREE], knots[-_DEGREE - 1])
    basis = BSpline.design_matrix(inside, knots, _DEGREE).tocsr()
    steps = np.gradient(times)
    weighted = basis.multiply(np.minimum(steps, 4.0 * np.median(steps))[:, None]).tocsr()
    differences = sparse.eye(size, format="csr")
    for _ in range(_ORDER):
        differences = differences[1:] - differences[:-1]
    penalty = _HALF_POWER * (2.0 * np.pi * cutoff * width) ** (-2 * _ORDER) * width
    normal = basis.T @ weighted + penalty * (differences.T @ differences)
    banded = np.zeros((_DEGREE + 1, size))
    for k in range(_DEGREE + 1):
        banded[_DEGREE - k, k:] = normal.diagonal(k)
    coefficients = solveh_banded(banded, weighted.T @ values, overwrite_ab=True)
    return _at(BSpline(knots, coefficients, _DEGREE), times, orders)


def _at(spline: BSpline, times: Array, orders: Sequence[int]) -> list[Array]:
    return [spline(times, nu=order) for order in orders]
