"""All frames of a trial at once, with accelerations that cost something.

    min sum_k f_k(y_k) + s^2 / 2 sum_k |a_k|^2

under the limits of each frame, a_k the second divided difference of y [rad/s^2]. Newton's method
on the whole trial: its matrix has a band of three frames. Source: G. H. Golub, C. F. Van Loan,
Matrix Computations, sec. 4.3.
"""

from __future__ import annotations

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.markers.marker_cost import Cost, Seen
from mbd_ros.features.markers.marker_fit import STILL, Bools, Fit, MarkerFit

_MAX_STEPS = 60
_FEWEST = 3  # frames that have an acceleration
_SHORTEST = 1.0e-6  # share of a step
_FLOOR = 1.0e-12  # of the largest entry, so that the matrix is regular


def smooth_trial(solver: MarkerFit, fit: Fit, seen: Seen, smoothness: float) -> Fit:
    """The best smooth motion near one that was fitted frame by frame.

    Args:
        solver: Its limits are kept; loops are refused.
        fit: Where to start.
        smoothness: s, the error of markers over that of the acceleration [m s^2/rad], or
            dimensionless times s^2 for joints that slide.

    Raises:
        ModelError: Loops or free bodies, which this does not serve.
        SolveError: It does not settle.
    """
    cost = solver.cost
    if solver.loops is not None or fit.q.shape[1] != cost.ancestry.shape[0]:
        raise ModelError("smoothness goes with scenes without loops and free bodies")
    if len(seen.times) < _FEWEST:
        return fit
    band = _Band(seen.times, cost.ancestry.shape[1], smoothness)
    q, at = fit.q, cost.at(fit.q, seen)
    for steps in range(_MAX_STEPS):
        y = q[:, cost.y_of_q]
        slope = at.slope + band.slope(y)
        held: Bools = ((y <= solver.lower) & (slope > 0.0)) | ((y >= solver.upper) & (slope < 0.0))
        p = band.step(at, slope, held)
        left = float(np.abs(p).max())
        if left <= STILL:
            return _fitted(fit, q, at, left, steps)
        q, at = _lower(solver, seen, band, q, at, p)
    raise SolveError(f"the smooth motion does not settle: its last step is {left:.3g} rad or m")


def _lower(
    solver: MarkerFit, seen: Seen, band: _Band, q: Array, at: Cost, p: Array
) -> tuple[Array, Cost]:
    """The motion after the largest share of a step that lowers the objective."""
    cost, share = solver.cost, 1.0
    y = q[:, cost.y_of_q]
    before = at.value.sum() + band.value(y)
    while share > _SHORTEST:
        inside = np.minimum(np.maximum(y + share * p, solver.lower), solver.upper)
        there = cost.moved(q, inside - y)
        after = cost.at(there, seen)
        if after.value.sum() + band.value(inside) <= before * (1.0 + STILL**2) + STILL**3:
            return there, after
        share *= 0.5
    raise SolveError("the smooth motion finds no lower objective: take less smoothness")


def _fitted(fit: Fit, q: Array, at: Cost, left: float, steps: int) -> Fit:
    return fit._replace(
        q=q,
        objective=at.value,
        misses=at.misses,
        remainder=np.full(len(q), left),
        steps=np.full(len(q), steps, dtype=np.intp),
    )


class _Band:
    """The share of accelerations in the objective, and the matrix of Newton's method.

    Args:
        times: [s], increasing, shape (N,).
        n: Coordinates of a frame.
        smoothness: s.
    """

    def __init__(self, times: Array, n: int, smoothness: float) -> None:
        before, after = np.diff(times)[:-1], np.diff(times)[1:]
        both = before + after
        self._c = np.stack((2.0 / (before * both), -2.0 / (before * after), 2.0 / (after * both)))
        self._s2, self._n, self._N = smoothness**2, n, len(times)

    def value(self, y: Array) -> float:
        """Its share in the objective."""
        return float(0.5 * self._s2 * (self._acceleration(y) ** 2).sum())

    def slope(self, y: Array) -> Array:
        """Its share in the slope, shape (N, n)."""
        a, slope = self._acceleration(y), np.zeros(y.shape)
        for i, c in enumerate(self._c):
            slope[i : len(a) + i] += self._s2 * c[:, None] * a
        return slope

    def step(self, at: Cost, slope: Array, held: Bools) -> Array:
        """Newton's step; coordinates that are held do not move, shape (N, n)."""
        from scipy.linalg import solveh_banded  # here: only who asks for smoothness loads it

        N, n = slope.shape
        size, width = N * n, 2 * n
        flat = np.zeros((width + 1, size))  # lower form: flat[i - j, j]
        free = ~held.ravel()
        blocks = at.hessian
        for i in range(n):
            for j in range(i + 1):
                flat[i - j, j::n] += blocks[:, i, j]
        for i in range(3):
            for j in range(i + 1):
                term = np.zeros(N)
                term[j : N - 2 + j] = self._s2 * self._c[i] * self._c[j]
                flat[(i - j) * n] += np.repeat(term, n)
        flat[0] += _FLOOR * flat[0].max()
        for d in range(1, width + 1):
            flat[d, : size - d] *= free[d:] & free[: size - d]
        flat[0] = np.where(free, flat[0], 1.0)
        right = np.where(free, -slope.ravel(), 0.0)
        return np.array(solveh_banded(flat, right, lower=True).reshape(N, n))

    def _acceleration(self, y: Array) -> Array:
        """Second divided differences, shape (N - 2, n)."""
        c = self._c[:, :, None]
        return np.array(c[0] * y[:-2] + c[1] * y[1:-1] + c[2] * y[2:])
