"""All frames of a trial, one after the other or at once.

The first frame is sought from several starts. Frames 0.1 s apart follow from it, all at once, and
the frames between them from these. A frame whose solution is far from that of the frame before is
sought again from there, and keeps what fits better.

A smooth motion costs its accelerations, too,

    min sum_k f_k(y_k) + s^2 / 2 sum_k |a_k|^2

under the limits of each frame, a_k the second divided difference of y [rad/s^2]. Newton's method
on the whole trial: its matrix has a band of three frames. Source: G. H. Golub, C. F. Van Loan,
Matrix Computations, sec. 4.3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.model.robot import Base, Joint, Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.markers.marker_cost import Cost, Frames, Seen
from mbd_ros.features.markers.marker_fit import STILL, Bools, Fit, Indices, MarkerFit, joined

_STARTS = 6  # of the first frame besides the default pose
_STEPS = 40  # from each of them
_BETTER = 0.5  # of the objective from the default pose: what another start must reach
_GOOD = 1.0e-12  # m^2, of an objective that needs no other start
_APART = 0.1  # s between frames that follow from the first one at once
_FASTEST, _JUMP = 12.0, 0.2  # rad/s or m/s, and rad or m: beyond both neighbours count as apart
_TURN = 2.0 * np.pi
_SEED = 0
_MAX_STEPS = 60
_FEWEST = 3  # frames that have an acceleration
_SHORTEST = 1.0e-6  # share of a step
_FLOOR = 1.0e-12  # of the largest entry, so that the matrix is regular


def fit_trial(fit: MarkerFit, robot: Robot, start: Array, seen: Seen) -> Fit:
    """Fit every frame.

    Args:
        start: Default configuration, shape (nq,).
        seen: What was seen, frames in the order of their times.

    Raises:
        SolveError: Loops do not close near a start.
    """
    first = first_frame(fit, robot, start, seen.of(slice(0, 1)))
    coarse = _apart(seen.times)
    some = fit.fit(np.repeat(first.q, len(coarse), axis=0), seen.of(coarse), far=True)
    some = _continued(fit, first.q[0], some, seen.of(coarse))
    every = fit.fit(_between(some.q, coarse, seen.times, robot), seen)
    return _continued(fit, first.q[0], every, seen)


def first_frame(fit: MarkerFit, robot: Robot, start: Array, seen: Seen) -> Fit:
    """Fit one frame from several starts, the default configuration first.

    Args:
        fit: Solver of the frames.
        robot: The robot.
        start: Default configuration, shape (nq,).
        seen: Measured markers of the frame.
    """
    default = fit.fit(start[None], seen, far=True)
    if default.objective[0] <= _GOOD:
        return default
    starts = _others(fit, robot, start)
    frames = np.zeros(len(starts), dtype=np.intp)
    fits = fit.fit(np.array(starts), seen.of(frames), far=True, steps=_STEPS)
    best = int(np.argmin(fits.objective))
    if not fits.objective[best] < _BETTER * default.objective[0]:
        return default
    return fit.fit(_unwound(fit, robot, fits.q[best : best + 1]), seen)


def of_frames(fit: Fit, frames: Frames) -> Fit:
    """Return some frames of a fit."""
    return Fit(*(each[frames] for each in fit))  # type: ignore[arg-type]


def _others(fit: MarkerFit, robot: Robot, start: Array) -> Sequence[Array]:
    """Return random starts in the ranges of joints and with random rotations of free bodies."""
    rng, others = np.random.default_rng(_SEED), []
    cost = fit.cost
    observed = set(cost.couplings.v_index[cost.reached > 0.0].tolist())
    for _ in range(_STARTS):
        q = start.copy()
        for joint in robot.joints:
            low, high = _range(joint, start[joint.q])
            if joint.v in observed:
                q[joint.q] = rng.uniform(low, high)
        for base in robot.bases:
            turn = rng.normal(size=4)
            q[_quaternion(base)] = turn / np.linalg.norm(turn)
        others.append(q)
    return others


def _range(joint: Joint, at: float) -> tuple[float, float]:
    """Return the range of starts of a joint: its limits within a turn, for free slides none."""
    if joint.kind == "prismatic":
        reach = 0.0 if not np.isfinite(joint.upper - joint.lower) else 0.1
    else:
        reach = np.pi
    low, high = max(joint.lower, at - reach), min(joint.upper, at + reach)
    return (low, high) if low <= high else (at, at)


def _unwound(fit: MarkerFit, robot: Robot, q: Array) -> Array:
    """The same pose with whole turns taken off joints that nothing follows and limits allow."""
    q, followed = q.copy(), set(fit.cost.couplings.parents.values())
    dependent = set(fit.cost.couplings.dependent)
    for joint in robot.joints:
        if joint.kind == "prismatic" or joint.name in followed | dependent:
            continue
        turned = q[:, joint.q] - _TURN * np.round(q[:, joint.q] / _TURN)
        inside = (turned >= joint.lower) & (turned <= joint.upper)
        q[:, joint.q] = np.where(inside, turned, q[:, joint.q])
    return q


def _apart(times: Array) -> Indices:
    """Frames at least some time apart, the first one among them."""
    chosen, last = [0], times[0]
    for i, t in enumerate(times.tolist()):
        if t - last >= _APART:
            chosen.append(i)
            last = t
    return np.array(chosen, dtype=np.intp)


def _between(q: Array, known: Indices, times: Array, robot: Robot) -> Array:
    """Starts of all frames from those that are known: smooth between, or the nearest ones."""
    if robot.bases:
        middles = 0.5 * (times[known[1:]] + times[known[:-1]])
        return np.array(q[np.searchsorted(middles, times)])
    if len(known) == 1:
        return np.repeat(q, len(times), axis=0)
    return _smooth(times[known], q, times)


def _smooth(known: Array, q: Array, times: Array) -> Array:
    """Cubic pieces through values, with the slopes of parabolas; constant beyond the last one."""
    slopes = np.gradient(q, known, axis=0)
    at = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
    h = np.diff(known)[at][:, None]
    s = np.clip((times - known[at])[:, None] / h, 0.0, 1.0)
    change, first, last = q[at + 1] - q[at], h * slopes[at], h * slopes[at + 1]
    bend = (1.0 - s) * (first - change) - s * (last - change)
    return np.array(q[at] + s * (change + (1.0 - s) * bend))


def _continued(fit: MarkerFit, start: Array, trial: Fit, seen: Seen) -> Fit:
    """Fit frames that are far from the previous one again, starting from that one."""
    reach = np.maximum(_JUMP, _FASTEST * np.diff(seen.times, prepend=seen.times[0]))
    moved = np.abs(np.diff(trial.q, axis=0, prepend=start[None])).max(axis=1, initial=0.0)
    far = np.flatnonzero(moved > reach)
    if not len(far):
        return trial
    before, frames = start, []
    for i in range(int(far[0]), len(trial.q)):
        before = trial.q[i - 1] if i == far[0] and i else before
        frame = of_frames(trial, slice(i, i + 1))
        if np.abs(frame.q[0] - before).max() > reach[i]:
            again = fit.fit(before[None], seen.of(slice(i, i + 1)))
            if again.objective[0] < frame.objective[0]:
                frame = again
                frames.append((i, frame))
        before = frame.q[0]
    parts, last = [], 0
    for i, frame in frames:
        parts += [of_frames(trial, slice(last, i)), frame]
        last = i + 1
    return joined([part for part in (*parts, of_frames(trial, slice(last, None))) if len(part.q)])


def _quaternion(base: Base) -> slice:
    return slice(base.q.start + 3, base.q.stop)


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

    def step(self, at: Cost, slope: Array, fixed: Bools) -> Array:
        """Newton's step; coordinates that are held do not move, shape (N, n)."""
        from scipy.linalg import solveh_banded  # here: only who asks for smoothness loads it

        N, n = slope.shape
        size, width = N * n, 2 * n
        flat = np.zeros((width + 1, size))  # lower form: flat[i - j, j]
        free = ~fixed.ravel()
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
