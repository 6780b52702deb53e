"""All frames of a trial, one after the other or at once.

The first frame is sought from several starts. Frames 0.1 s apart follow from it, all at once, and
the frames between them from these. A frame whose solution is far from that of the frame before is
sought again from there, and keeps what fits better.
"""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.model.robot import Base, Joint, Robot
from mbd_ros.core.state import Array
from mbd_ros.features.markers.marker_cost import Frames, Seen
from mbd_ros.features.markers.marker_fit import (
    Fit,
    Indices,
    MarkerFit,
    joined,
)

_STARTS = 6  # of the first frame besides the default pose
_STEPS = 40  # from each of them
_BETTER = 0.5  # of the objective from the default pose: what another start must reach
_GOOD = 1.0e-12  # m^2, of an objective that needs no other start
_APART = 0.1  # s between frames that follow from the first one at once
_FASTEST, _JUMP = 12.0, 0.2  # rad/s or m/s, and rad or m: beyond both neighbours count as apart
_TURN = 2.0 * np.pi
_SEED = 0


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
    """The best configuration of one frame from several starts, the default pose first.

    Args:
        start: Default configuration, shape (nq,).
        seen: One frame.
    """
    own = fit.fit(start[None], seen, far=True)
    if own.objective[0] <= _GOOD:
        return own
    starts = _others(fit, robot, start)
    frames = np.zeros(len(starts), dtype=np.intp)
    found = fit.fit(np.array(starts), seen.of(frames), far=True, steps=_STEPS)
    best = int(np.argmin(found.objective))
    if not found.objective[best] < _BETTER * own.objective[0]:
        return own
    return fit.fit(_unwound(fit, robot, found.q[best : best + 1]), seen)


def of_frames(fit: Fit, frames: Frames) -> Fit:
    """Some frames of a fit."""
    return Fit(*(each[frames] for each in fit))  # type: ignore[arg-type]


def _others(fit: MarkerFit, robot: Robot, start: Array) -> Sequence[Array]:
    """Starts all over the range of joints and the turns of free bodies."""
    rng, others = np.random.default_rng(_SEED), []
    cost = fit.cost
    shown = set(cost.couplings.v_index[cost.reached > 0.0].tolist())
    for _ in range(_STARTS):
        q = start.copy()
        for joint in robot.joints:
            low, high = _range(joint, start[joint.q])
            if joint.v in shown:
                q[joint.q] = rng.uniform(low, high)
        for base in robot.bases:
            turn = rng.normal(size=4)
            q[_quaternion(base)] = turn / np.linalg.norm(turn)
        others.append(q)
    return others


def _range(joint: Joint, at: float) -> tuple[float, float]:
    """Where starts of a joint lie: its limits within a turn, where it slides freely nowhere."""
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


def _continued(fit: MarkerFit, start: Array, found: Fit, seen: Seen) -> Fit:
    """The fit, with frames that are far from the one before sought again from there."""
    reach = np.maximum(_JUMP, _FASTEST * np.diff(seen.times, prepend=seen.times[0]))
    moved = np.abs(np.diff(found.q, axis=0, prepend=start[None])).max(axis=1, initial=0.0)
    far = np.flatnonzero(moved > reach)
    if not len(far):
        return found
    before, frames = start, []
    for i in range(int(far[0]), len(found.q)):
        before = found.q[i - 1] if i == far[0] and i else before
        one = of_frames(found, slice(i, i + 1))
        if np.abs(one.q[0] - before).max() > reach[i]:
            again = fit.fit(before[None], seen.of(slice(i, i + 1)))
            if again.objective[0] < one.objective[0]:
                one = again
                frames.append((i, one))
        before = one.q[0]
    parts, last = [], 0
    for i, one in frames:
        parts += [of_frames(found, slice(last, i)), one]
        last = i + 1
    return joined([part for part in (*parts, of_frames(found, slice(last, None))) if len(part.q)])


def _quaternion(base: Base) -> slice:
    return slice(base.q.start + 3, base.q.stop)
