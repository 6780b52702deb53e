"""Goals of a trajectory: the tolerances of their joints, and when and how they end.

Source: the meaning of tolerances and codes is that of control_msgs/action/FollowJointTrajectory,
and where it leaves a choice that of the joint_trajectory_controller of ros2_control.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from mbd_ros.core.control.contract import Reference
from mbd_ros.core.state import Array
from mbd_ros.features.control.reference_limits import TargetError


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


class JointTolerance(NamedTuple):
    """Tolerances of a goal for one joint: 0 leaves the default, a negative number lifts it.

    Attributes:
        name: The joint.
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


class TrajectoryGoal:
    """A trajectory on its way.

    On the way every joint must keep the path tolerances. From the last point on, once the
    reference rests there, the goal is reached as soon as every joint keeps the goal tolerances,
    and missed after `tolerances.time`.

    Args:
        names: Joints, in the order of all arrays.
        tolerances: See there.
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
