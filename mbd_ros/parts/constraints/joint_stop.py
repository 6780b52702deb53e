"""Ends of the range of joints."""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.ranges import OptionalDuration, Restitution, Unit
from mbd_ros.core.rows.constraint import Constraint, Row, Stop, unilateral
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_FAR = 1.0e200  # stands for no end where infinity times 0 would be NaN


class JointStop(Constraint):
    """Ends of the range of joints, one row a joint.

        g = q - lower (J = +e) or g = upper - q (J = -e),   0 <= multiplier

    A joint moves freely up to its end, and hits it there: an impact with Poisson's restitution. A
    positive multiplier pushes the joint away from the end. The row stands for the nearer end.

    A smoothed stop acts as soon as g'' + 2 g' / T + g / T^2 would be negative: the joint comes to
    the end exponentially and does not bounce. Its row stands for the end that the joint heads
    for, the one with the smaller g + 2 T g'.

    Args:
        joint: The joint with stops, or else `joints`.
        joints: Several joints, or [all]: every one with a limit in the robot description, or every
            one at all with `lower` or `upper`.
        lower: Lower end; that of the robot description by default.
        upper: Upper end; that of the robot description by default.
        restitution: Share of the impulse of compression that an impact gives back.
        smoothed: Whether the stop is solved for in every evaluation, which costs the order of the
            method; that is so with a time constant, too.
        time_constant: T of a smoothed stop, 0.01 s by default.
    """

    example = {"joint": "ankle", "lower": -0.3, "upper": 0.35, "restitution": 0.2}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str | None = None,
        joints: Sequence[str] | None = None,
        lower: Annotated[float | None, Unit("rad or m")] = None,
        upper: Annotated[float | None, Unit("rad or m")] = None,
        restitution: Annotated[Restitution, Unit("-")] = 0.0,
        smoothed: bool = False,
        time_constant: OptionalDuration = None,
    ) -> None:
        stopped = _stopped(robot, joint, joints, lower is None and upper is None)
        ends = [_ends(one, lower, upper) for one in stopped]
        self.smoothed = smoothed or time_constant is not None
        T = 0.01 if time_constant is None else time_constant
        n, kp, kd = len(stopped), 1.0 / T**2, 2.0 / T
        self.joints = tuple(one.name for one in stopped)
        self.rows = tuple(Row(_quantity(one, n), one.effort_unit) for one in stopped)
        self.law = unilateral(restitution)
        self.gains = (kp, kd)
        self._lower, self._upper = np.array(ends).T
        self.stops = tuple(Stop(one, *end) for one, end in zip(stopped, ends, strict=True))
        self._q = _where([one.q for one in stopped])
        self._v = _where([one.v for one in stopped])
        self._each = np.arange(n)
        self._at = np.array([one.v for one in stopped])
        self._ahead = kd / kp if self.smoothed else 0.0
        self._zero = np.zeros(n)
        self._nv = int(robot.model.nv)
        self._has_bases = robot.floating
        self._q_of = _where([one.q for one in robot.joints])
        self._v_of = _where([one.v for one in robot.joints])
        self._rows = _margin_rows(robot, stopped, ends)
        self._q_row, self._v_row, self._a_row = self._rows[:3]
        condition = np.array(((kp, kd, 1.0, -kp, 0.0), (-kp, -kd, -1.0, 0.0, kp)))
        self._margins = np.empty((2, len(robot.joints)))
        flat = self._margins.reshape(-1)
        self._combine = condition.dot
        self._smallest = flat.argmin
        self._item = flat.item

    @staticmethod
    def check(
        robot: Robot,
        joint: str | None,
        joints: Sequence[str] | None,
        lower: float | None,
        upper: float | None,
        restitution: float,
        smoothed: bool,
        time_constant: float | None,
    ) -> None:
        """Refuse joints without any end, ends in the wrong order, and smoothed bounces."""
        if restitution > 0.0 and (smoothed or time_constant is not None):
            raise ModelError(
                f"restitution {restitution:g} needs an exact stop: leave out smoothed and "
                "time_constant"
            )
        for one in _stopped(robot, joint, joints, lower is None and upper is None):
            low, high = _ends(one, lower, upper)
            if math.isinf(low) and math.isinf(high):
                raise ModelError(f"joint '{one.name}' has no limits, give lower or upper")
            if not low < high:
                raise ModelError(
                    f"joint '{one.name}': lower {low:g} must be less than upper {high:g}"
                )

    def quick_margin(self, q: Array, v: Array, a: Array) -> float:
        """Smallest g'' + kd g' + kp g of both ends of all joints; positive while none acts.

        Args:
            q: Configuration of all joints, shape (nq,).
            a: Acceleration without the stops, shape (nv,).
        """
        if self._has_bases:
            q, v, a = q[self._q_of], v[self._v_of], a[self._v_of]
        self._q_row[:] = q
        self._v_row[:] = v
        self._a_row[:] = a
        self._combine(self._rows, self._margins)
        return self._item(self._smallest())

    def residual(self, k: Kinematics, x: State) -> Array:
        """Gap to the end that every joint heads for [rad or m], shape (m,)."""
        q = x.q[self._q]
        gap: Array = k.choose(*self._ahead_of_both(x), q - self._lower, self._upper - q)
        return gap

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """1 or -1 at the joint of every row, shape (m, nv)."""
        J = k.zeros((len(self.rows), self._nv))
        J[self._each, self._at] = k.choose(*self._ahead_of_both(x), 1.0, -1.0)
        return J

    def drift(self, k: Kinematics, x: State) -> Array:
        """Zero, shape (m,)."""
        return self._zero

    def _ahead_of_both(self, x: State) -> tuple[Array, Array]:
        """Gaps to both ends that every joint heads for: the smaller one counts."""
        ahead = x.q[self._q] + self._ahead * x.v[self._v]
        return ahead - self._lower, self._upper - ahead


def _stopped(
    robot: Robot, joint: str | None, joints: Sequence[str] | None, by_description: bool
) -> list[Joint]:
    if (joint is None) == (joints is None):
        raise ModelError("give either 'joint' or 'joints'")
    if joints is None:
        assert joint is not None
        return [robot.joint(joint)]
    if list(joints) == ["all"]:
        if not by_description:
            return list(robot.joints)
        limited = [j for j in robot.joints if math.isfinite(j.lower) or math.isfinite(j.upper)]
        if not limited:
            raise ModelError("joints [all]: no joint has a limit in the robot description")
        return limited
    if not joints or len(set(joints)) < len(joints):
        raise ModelError(f"joints {list(joints)} must be [all] or different joints")
    return [robot.joint(name) for name in joints]


def _ends(joint: Joint, lower: float | None, upper: float | None) -> tuple[float, float]:
    return joint.lower if lower is None else lower, joint.upper if upper is None else upper


def _quantity(joint: Joint, count: int) -> str:
    """Name of the multiplier of one of several joints."""
    own = "" if count == 1 else f"_{joint.name.replace('.', '_')}"
    return f"{joint.effort_name}{own}"


def _where(indices: list[int]) -> Any:
    """A slice where possible: it costs a third of an index array."""
    first, last = indices[0], indices[0] + len(indices)
    return slice(first, last) if indices == list(range(first, last)) else np.array(indices)


def _margin_rows(robot: Robot, stopped: list[Joint], ends: list[tuple[float, float]]) -> Array:
    """Room for q, v and a of all joints above lower and upper ends, shape (5, joints)."""
    rows = np.zeros((5, len(robot.joints)))
    rows[3], rows[4] = -_FAR, _FAR
    for joint, (lower, upper) in zip(stopped, ends, strict=True):
        column = robot.joints.index(joint)
        rows[3, column], rows[4, column] = max(lower, -_FAR), min(upper, _FAR)
    return rows
