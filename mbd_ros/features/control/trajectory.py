"""Trajectories of joints over time, the limits they keep, and their goals.

A trajectory is polynomials between points, at rest before and after. A goal says how far joints
may be from it, and tells when and how it ends.
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
_SAMPLES = 16  # of a piece, among which extremes are looked for
_ROUNDING = 1.0e-9  # rad or m, and share of a speed limit


class ReferenceTrajectory:
    """Quintic pieces through points with accelerations, else cubic ones; C2 or C1.

    It stands at the first point before, and at the last point after. A point without velocity
    takes the mean slope of its neighbours; the first and last point rest.

    Args:
        times: [s], strictly increasing, shape (k,), k >= 1.
        q: Positions [rad or m], shape (k, n).
        v: Velocities [rad/s or m/s], shape (k, n), or None.
        a: Accelerations [rad/s^2 or m/s^2], shape (k, n), or None; read beside `v` only.
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
        """Position, velocity and acceleration at a time [s]; fresh arrays."""
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
        """Times (m,), positions (m, n) and velocities (m, n), dense enough to see extremes."""
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
    """Velocities of points that have none: the mean slope of both sides, rest at both ends.

    Args:
        times: [s], shape (k,).
        q: [rad or m], shape (k, n).

    Returns:
        Fresh, shape (k, n).
    """
    v = np.zeros_like(q)
    if len(times) > 2:
        v[1:-1] = np.gradient(q, times, axis=0)[1:-1]
    return v


class ReferenceLimits:
    """Position and velocity limits of joints as references see them.

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
        """Begin at a measured position; beyond a limit it widens that limit."""
        self._lowest, self._highest = np.minimum(self._lower, q), np.maximum(self._upper, q)

    def nearest(self, q: Array) -> Array:
        """The nearest position within the limits, fresh."""
        return np.minimum(np.maximum(q, self._lower), self._upper)

    def kept(self, ref: Reference) -> Reference:
        """The reference, at rest at a limit that it would leave."""
        q = np.minimum(np.maximum(ref.q, self._lowest), self._highest)
        beyond = q != ref.q
        if not beyond.any():
            return ref
        return Reference(q, np.where(beyond, 0.0, ref.v), np.where(beyond, 0.0, ref.a))

    def check(self, times: Array, q: Array, v: Array) -> None:
        """Refuse motion beyond the limits.

        Args:
            times: [s], shape (k,).
            q: [rad or m], shape (k, n).
            v: [rad/s or m/s], shape (k, n).

        Raises:
            TargetError: Names joint, time, value and what is accepted.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise TargetError("reference refused: not finite")
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
    """A reference that is refused: names the joint, its value and what is accepted."""


class JointTolerance(NamedTuple):
    """Tolerances of a goal for one joint: 0 leaves the default, a negative number lifts it.

    Attributes:
        position: [rad or m].
        velocity: [rad/s or m/s].
        acceleration: [rad/s^2 or m/s^2]; a tolerance > 0 cannot be watched.
    """

    name: str
    position: float
    velocity: float
    acceleration: float


class Tolerances(NamedTuple):
    """Accepted distances of measured joints from their trajectory; inf without a tolerance.

    Attributes:
        path_q: On the way [rad or m], shape (n,).
        path_v: On the way [rad/s or m/s], shape (n,).
        goal_q: At the end [rad or m], shape (n,).
        goal_v: At the end [rad/s or m/s], shape (n,).
        time: After the end until the goal must be reached [s].
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
        """These defaults, changed by the tolerances of a goal.

        Args:
            names: Joints, in the order of the arrays.
            path: On the way.
            goal: At the end.
            time: 0 leaves the default, a negative one lifts it [s].

        Raises:
            TargetError: An unknown joint, not a number, or a tolerance of acceleration.
        """
        path_q, path_v = _changed(names, "path_tolerance", self.path_q, self.path_v, path)
        goal_q, goal_v = _changed(names, "goal_tolerance", self.goal_q, self.goal_v, goal)
        within = _meant(time, self.time, "goal_time_tolerance")
        return Tolerances(path_q, path_v, goal_q, goal_v, within)


class ResultCode(IntEnum):
    """How a goal ended; values of the action."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Outcome(NamedTuple):
    """The end of a goal: its code, and the reason for people."""

    code: ResultCode
    text: str


class TrajectoryGoal:
    """A trajectory on its way: whether its joints keep their tolerances, and how it ends.

    On the way every joint must keep the path tolerances. From the last point on, once the
    reference rests there, the goal is reached as soon as every joint keeps the goal tolerances,
    and missed after `tolerances.time`. The meaning of tolerances and codes is that of
    control_msgs/action/FollowJointTrajectory, and where it leaves a choice that of the
    joint_trajectory_controller of ros2_control.

    Args:
        names: Joints, in the order of all arrays.
        tolerances: How far joints may be from the trajectory and its end.
        begin: Time from which the times of the points count [s].
        end: Of the last point [s].
        rest: When the reference comes to rest, after a ramp to a trajectory from elsewhere [s].
    """

    def __init__(
        self, names: Sequence[str], tolerances: Tolerances, begin: float, end: float, rest: float
    ) -> None:
        self._names, self._within = tuple(names), tolerances
        self.begin, self._end, self._rest = begin, end, max(rest, end)

    def judge(self, t: float, q: Array, v: Array, ref: Reference) -> Outcome | None:
        """How the goal ended at a time [s]; None while it continues.

        Args:
            t: Now [s].
            q: Measured [rad or m], shape (n,).
            v: Measured [rad/s or m/s], shape (n,).
            ref: Where the joints should be.
        """
        off, rate, within = np.abs(ref.q - q), np.abs(ref.v - v), self._within
        if t < self._end:
            if (off <= within.path_q).all() and (rate <= within.path_v).all():
                return None
            text = self._beyond(off, rate, within.path_q, within.path_v)
            said = f"path tolerance violated {t - self.begin:.3f} s after the begin: {text}"
            return Outcome(ResultCode.PATH_TOLERANCE_VIOLATED, said)
        is_there = (off <= within.goal_q).all() and (rate <= within.goal_v).all()
        if is_there and t >= self._rest:
            return Outcome(ResultCode.SUCCESSFUL, "goal reached")
        if t - self._end <= within.time:
            return None
        text = self._beyond(off, rate, within.goal_q, within.goal_v)
        said = f"goal not reached {t - self._end:.3f} s after the end of the trajectory, {text}"
        return Outcome(ResultCode.GOAL_TOLERANCE_VIOLATED, said)

    def _beyond(self, off: Array, rate: Array, most: Array, fastest: Array) -> str:
        """The joint that is furthest beyond, in shares of its tolerance."""
        for error, limit, unit in ((off, most, ""), (rate, fastest, "/s")):
            beyond = np.where(error > limit, error / limit, 0.0)
            if beyond.any():
                j = int(beyond.argmax())
                return f"{self._names[j]} is {error[j]:.4g}{unit} off, accepted {limit[j]:g}{unit}"
        return "the reference had to be ramped to where the trajectory begins"


def _changed(
    names: Sequence[str], field: str, q: Array, v: Array, given: Sequence[JointTolerance]
) -> tuple[Array, Array]:
    q, v = q.copy(), v.copy()
    for tolerance in given:
        where = f"{field} of '{tolerance.name:.64}'"
        if tolerance.name not in names:
            raise TargetError(
                f"goal refused: {where}: not controlled; accepted: {', '.join(names)}"
            )
        j = names.index(tolerance.name)
        q[j] = _meant(tolerance.position, q[j], f"{where}: position")
        v[j] = _meant(tolerance.velocity, v[j], f"{where}: velocity")
        if not tolerance.acceleration <= 0.0:
            raise TargetError(
                f"goal refused: {where}: acceleration {tolerance.acceleration:g}; accepted: 0, "
                "since joint states carry no accelerations"
            )
    return q, v


def _meant(given: float, default: float, where: str) -> float:
    if math.isnan(given):
        raise TargetError(f"goal refused: {where} is no number")
    if given == 0.0:
        return default
    return math.inf if given < 0.0 else given
