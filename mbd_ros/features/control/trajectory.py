"""Trajectories of joints over time, the limits they keep, and their goals.

A trajectory consists of polynomials between points, and rests before and after them. A goal has
tolerances of the joints along the trajectory, and judges when and how it ends.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import MbdError
from mbd_ros.methods.control.contract import ControlledJoints, Reference

# Rows: value, slope and curvature at the begin, the same at the end of an interval of length 1;
# columns: powers 0 .. 5.
_QUINTIC = np.array(
    [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ]
)
_CUBIC = np.array(
    [
        [1.0, 0.0, -3.0, 2.0],
        [0.0, 1.0, -2.0, 1.0],
        [0.0, 0.0, 3.0, -2.0],
        [0.0, 0.0, -1.0, 1.0],
    ]
)
PEAK_SPEED = 1.875  # of a quintic from rest to rest, in distance over duration
_SAMPLES = 16  # per piece, for the search of extreme values
_ROUNDING = 1.0e-9  # rad or m, and share of a speed limit


class ReferenceTrajectory:
    """Piecewise quintic (C2) through points with accelerations, otherwise piecewise cubic (C1).

    It rests at the first point before, and at the last point after. A point without velocity
    takes the mean slope of its neighbours; the first and the last point rest.

    Args:
        times: Strictly increasing times [s], shape (k,), k >= 1.
        q: Positions [rad or m], shape (k, n).
        v: Velocities [rad/s or m/s], shape (k, n), or None.
        a: Accelerations [rad/s^2 or m/s^2], shape (k, n), or None; used only with `v`.
    """

    def __init__(
        self, times: Array, q: Array, v: Array | None = None, a: Array | None = None
    ) -> None:
        self._times, self._last = times, len(times) - 1
        self._first_q, self._last_q = q[0], q[-1]
        self._rest = np.zeros(q.shape[1])
        h = np.diff(times)[:, None]
        self._h = h[:, 0]
        rates = slopes(times, q) if v is None else v
        begin, end = [q[:-1], h * rates[:-1]], [q[1:], h * rates[1:]]
        basis = _CUBIC
        if v is not None and a is not None:
            basis = _QUINTIC
            begin.append(h**2 * a[:-1])
            end.append(h**2 * a[1:])
        pieces = np.stack([*begin, *end])
        self._pieces = np.einsum("rp,rkn->kpn", basis, pieces)  # (k - 1, powers, n)
        self._powers = np.arange(len(basis[0]))

    @property
    def begin(self) -> float:
        """Time of the first point [s]."""
        return float(self._times[0])

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return float(self._times[-1])

    def at(self, t: float) -> Reference:
        """Return position, velocity and acceleration at a time [s]."""
        if t >= self.end:
            return Reference(self._last_q, self._rest, self._rest)
        if t < self.begin:
            return Reference(self._first_q, self._rest, self._rest)
        k = int(np.searchsorted(self._times, t, side="right")) - 1
        h, powers, piece = self._h[k], self._powers, self._pieces[k]
        monomials = ((t - self._times[k]) / h) ** powers
        first = powers[1:] * monomials[:-1]
        second = powers[2:] * first[:-1]
        return Reference(
            monomials.dot(piece), first.dot(piece[1:]) / h, second.dot(piece[2:]) / h**2
        )

    def samples(self) -> tuple[Array, Array, Array]:
        """Return m times, positions (m, n) and velocities (m, n) that show extreme values."""
        parts, powers = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False), self._powers
        inner = (self._times[:-1, None] + parts * self._h[:, None]).ravel()
        monomials = parts[:, None] ** powers
        first = powers[1:] * monomials[:, :-1]
        n = len(self._rest)
        q = np.einsum("sp,kpn->ksn", monomials, self._pieces).reshape(-1, n)
        v = np.einsum("sp,kpn,k->ksn", first, self._pieces[:, 1:], 1.0 / self._h).reshape(-1, n)
        return (
            np.append(inner, self.end),
            np.vstack([q, self._last_q]),
            np.vstack([v, self._rest]),
        )


def slopes(times: Array, q: Array) -> Array:
    """Return velocities for points without any: mean slopes of both sides, rest at both ends.

    Args:
        times: Times of the points [s], shape (k,).
        q: Positions [rad or m], shape (k, n).

    Returns:
        Velocities [rad/s or m/s], shape (k, n).
    """
    v = np.zeros_like(q)
    if len(times) > 2:
        v[1:-1] = np.gradient(q, times, axis=0)[1:-1]
    return v


class ReferenceLimits:
    """Position and velocity limits of joints for references.

    Attributes:
        fastest: Velocity limits [rad/s or m/s], shape (n,).
    """

    def __init__(self, joints: ControlledJoints) -> None:
        self._names = joints.names
        self._lower = np.array([joint.lower for joint in joints.joints])
        self._upper = np.array([joint.upper for joint in joints.joints])
        self._lowest, self._highest = self._lower, self._upper
        self.fastest = np.array([joint.max_velocity for joint in joints.joints])

    def begin(self, q: Array) -> None:
        """Start at a measured position; a position beyond a limit widens that limit."""
        self._lowest, self._highest = np.minimum(self._lower, q), np.maximum(self._upper, q)

    def nearest(self, q: Array) -> Array:
        """Return the nearest position within the limits."""
        return np.minimum(np.maximum(q, self._lower), self._upper)

    def clip(self, ref: Reference) -> Reference:
        """Return the reference, at rest at a limit that it would pass."""
        q = np.minimum(np.maximum(ref.q, self._lowest), self._highest)
        beyond = q != ref.q
        if not beyond.any():
            return ref
        return Reference(q, np.where(beyond, 0.0, ref.v), np.where(beyond, 0.0, ref.a))

    def check(self, times: Array, q: Array, v: Array) -> None:
        """Refuse motion beyond the limits.

        Args:
            times: Times [s], shape (k,).
            q: Positions [rad or m], shape (k, n).
            v: Velocities [rad/s or m/s], shape (k, n).

        Raises:
            TargetError: A value is not finite or beyond a limit; the message names joint, time,
                value and accepted values.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise TargetError("reference refused: a position or velocity is not finite")
        off = (q < self._lower - _ROUNDING) | (q > self._upper + _ROUNDING)
        if off.any():
            i, j = np.argwhere(off)[0]
            raise TargetError(
                f"reference refused: {self._names[j]} at {q[i, j]:.4g} at t = {times[i]:.4g} s; "
                f"accepted: {self._lower[j]:g} to {self._upper[j]:g}"
            )
        fast = np.abs(v) > self.fastest * (1.0 + _ROUNDING)
        if fast.any():
            i, j = np.argwhere(fast)[0]
            raise TargetError(
                f"reference refused: {self._names[j]} at {v[i, j]:.4g}/s at t = {times[i]:.4g} s; "
                f"accepted: up to {self.fastest[j]:g}/s"
            )


class TargetError(MbdError):
    """A refused reference or goal; the message names the joint, its value and accepted values."""


class JointTolerance(NamedTuple):
    """Tolerances of a goal for one joint: 0 keeps the default, a negative number removes it.

    Attributes:
        name: Name of the joint.
        position: Tolerance of the position [rad or m].
        velocity: Tolerance of the velocity [rad/s or m/s].
        acceleration: Tolerance of the acceleration [rad/s^2 or m/s^2]; must not be above 0, since
            joint states carry no accelerations.
    """

    name: str
    position: float
    velocity: float
    acceleration: float


class Tolerances(NamedTuple):
    """Accepted distances of measured joints from their trajectory; inf without a tolerance.

    Attributes:
        path_q: Tolerances of positions along the path [rad or m], shape (n,).
        path_v: Tolerances of velocities along the path [rad/s or m/s], shape (n,).
        goal_q: Tolerances of positions at the end [rad or m], shape (n,).
        goal_v: Tolerances of velocities at the end [rad/s or m/s], shape (n,).
        time: Time after the end within which the goal must be reached [s].
    """

    path_q: Array
    path_v: Array
    goal_q: Array
    goal_v: Array
    time: float

    def of_goal(
        self,
        names: Sequence[str],
        path: Sequence[JointTolerance],
        goal: Sequence[JointTolerance],
        time: float,
    ) -> "Tolerances":
        """Return these defaults, changed by the tolerances of a goal.

        Args:
            names: Joints, in the order of the arrays.
            path: Tolerances along the path.
            goal: Tolerances at the end.
            time: Time within which the goal must be reached [s]; 0 keeps the default, a negative
                number removes it.

        Raises:
            TargetError: A joint is unknown, a tolerance is no number, or one of acceleration is
                above 0.
        """
        path_q, path_v = _replace(names, "path_tolerance", self.path_q, self.path_v, path)
        goal_q, goal_v = _replace(names, "goal_tolerance", self.goal_q, self.goal_v, goal)
        goal_time = _tolerance(time, self.time, "goal_time_tolerance")
        return Tolerances(path_q, path_v, goal_q, goal_v, goal_time)


class ResultCode(IntEnum):
    """Result codes of the action FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Outcome(NamedTuple):
    """Result of a goal: its code, and the reason for people."""

    code: ResultCode
    text: str


class TrajectoryGoal:
    """A trajectory that is being followed, with its tolerances.

    Along the path every joint must keep the path tolerances. From the last point on, once the
    reference rests there, the goal is reached as soon as every joint keeps the goal tolerances,
    and missed after `tolerances.time`. Tolerances and codes have the meaning of
    control_msgs/action/FollowJointTrajectory and, where that leaves a choice, of the
    joint_trajectory_controller of ros2_control.

    Args:
        names: Joints, in the order of all arrays.
        tolerances: Tolerances along the path and at the end.
        begin: Time from which the times of the points count [s].
        end: Time of the last point [s].
        rest: Time at which the reference comes to rest [s]; later than `end` if it had to ramp to
            the trajectory.
    """

    def __init__(
        self, names: Sequence[str], tolerances: Tolerances, begin: float, end: float, rest: float
    ) -> None:
        self._names, self._tolerances = tuple(names), tolerances
        self.begin, self._end, self._rest = begin, end, max(rest, end)

    def judge(self, t: float, q: Array, v: Array, ref: Reference) -> Outcome | None:
        """Return the outcome of the goal; None while it continues.

        Args:
            t: Present time [s].
            q: Measured positions [rad or m], shape (n,).
            v: Measured velocities [rad/s or m/s], shape (n,).
            ref: Reference at that time.
        """
        off, rate, within = np.abs(ref.q - q), np.abs(ref.v - v), self._tolerances
        if t < self._end:
            if (off <= within.path_q).all() and (rate <= within.path_v).all():
                return None
            text = self._beyond(off, rate, within.path_q, within.path_v)
            text = f"path tolerance violated {t - self.begin:.3f} s after the begin: {text}"
            return Outcome(ResultCode.PATH_TOLERANCE_VIOLATED, text)
        is_there = (off <= within.goal_q).all() and (rate <= within.goal_v).all()
        if is_there and t >= self._rest:
            return Outcome(ResultCode.SUCCESSFUL, "goal reached")
        if t - self._end <= within.time:
            return None
        text = self._beyond(off, rate, within.goal_q, within.goal_v)
        text = f"goal not reached {t - self._end:.3f} s after the end of the trajectory, {text}"
        return Outcome(ResultCode.GOAL_TOLERANCE_VIOLATED, text)

    def _beyond(self, off: Array, rate: Array, most: Array, fastest: Array) -> str:
        """Describe the joint that exceeds its tolerance by the largest factor."""
        for error, limit, unit in ((off, most, ""), (rate, fastest, "/s")):
            beyond = np.where(error > limit, error / limit, 0.0)
            if beyond.any():
                j = int(beyond.argmax())
                return f"{self._names[j]} is {error[j]:.4g}{unit} off, accepted {limit[j]:g}{unit}"
        return "the reference had to be ramped to where the trajectory begins"


def _replace(
    names: Sequence[str], field: str, q: Array, v: Array, tolerances: Sequence[JointTolerance]
) -> tuple[Array, Array]:
    q, v = q.copy(), v.copy()
    for tolerance in tolerances:
        where = f"{field} of '{tolerance.name:.64}'"
        if tolerance.name not in names:
            raise TargetError(
                f"goal refused: {where}: the joint is not controlled; accepted: {', '.join(names)}"
            )
        j = names.index(tolerance.name)
        q[j] = _tolerance(tolerance.position, q[j], f"{where}: position")
        v[j] = _tolerance(tolerance.velocity, v[j], f"{where}: velocity")
        if not tolerance.acceleration <= 0.0:
            raise TargetError(
                f"goal refused: {where}: acceleration {tolerance.acceleration:g}; accepted: 0, "
                "since joint states carry no accelerations"
            )
    return q, v


def _tolerance(value: float, default: float, where: str) -> float:
    if math.isnan(value):
        raise TargetError(f"goal refused: {where} is not a number")
    if value == 0.0:
        return default
    return math.inf if value < 0.0 else value
