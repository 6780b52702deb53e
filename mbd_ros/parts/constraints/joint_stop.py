"""Joint limits as unilateral constraints."""

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.ranges import OptionalDuration, Restitution, Unit
from mbd_ros.core.rows.constraint import Constraint, Row, Stop, unilateral
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_FAR = 1.0e200  # replaces an infinite limit, since infinity times 0 is NaN


class JointStop(Constraint):
    """Stops at the ends of the range of one or more joints, with one row per joint.

        g = q - lower (J = +e) or g = upper - q (J = -e),   0 <= multiplier

    A joint moves freely up to a stop and hits it there, with Poisson's restitution. A positive
    multiplier pushes the joint away from the stop. The row belongs to the nearer stop.

    A smoothed stop acts as soon as g'' + 2 g' / T + g / T^2 would be negative: the joint
    approaches the stop exponentially and does not bounce. Its row belongs to the stop that the
    joint moves towards, the one with the smaller g + 2 T g'.

    Args:
        joint: Joint with stops; give either `joint` or `joints`.
        joints: Several joints, or [all]: with `lower` or `upper` all joints, otherwise all joints
            with a limit in the robot description.
        lower: Lower end of the range; by default that of the robot description.
        upper: Upper end of the range; by default that of the robot description.
        restitution: Poisson's coefficient of restitution, the ratio of the impulse of expansion to
            that of compression.
        smoothed: Whether the stop is solved for in every evaluation instead of switching at
            events, which lowers the order of the integrator; `time_constant` implies it.
        time_constant: Time constant T of a smoothed stop, 0.01 s by default.
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
        limited = _limited_joints(robot, joint, joints, lower is None and upper is None)
        limits = [_limits(j, lower, upper) for j in limited]
        self.smoothed = smoothed or time_constant is not None
        T = 0.01 if time_constant is None else time_constant
        n, kp, kd = len(limited), 1.0 / T**2, 2.0 / T
        self.joints = tuple(j.name for j in limited)
        self.rows = tuple(Row(_multiplier_name(j, n), j.effort_unit) for j in limited)
        self.law = unilateral(restitution)
        self.gains = (kp, kd)
        self._lower, self._upper = np.array(limits).T
        self.stops = tuple(Stop(j, *ends) for j, ends in zip(limited, limits, strict=True))
        self._q = _as_slice([j.q for j in limited])
        self._v = _as_slice([j.v for j in limited])
        self._row_indices = np.arange(n)
        self._columns = np.array([j.v for j in limited])
        self._lookahead = kd / kp if self.smoothed else 0.0  # [s]
        self._zero = np.zeros(n)
        self._nv = int(robot.model.nv)
        # `quick_margin` is called in every evaluation: its arrays and methods are bound here.
        self._has_bases = robot.floating
        self._all_q = _as_slice([j.q for j in robot.joints])
        self._all_v = _as_slice([j.v for j in robot.joints])
        self._margin_terms = _margin_terms(robot, limited, limits)
        self._q_row = self._margin_terms[0]
        self._v_row = self._margin_terms[1]
        self._a_row = self._margin_terms[2]
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
        """Refuse joints without limits, lower limits above upper ones, and smoothed bounces."""
        if restitution > 0.0 and (smoothed or time_constant is not None):
            raise ModelError(
                f"restitution {restitution:g} is not accepted with smoothed or time_constant, "
                "since a smoothed stop does not bounce"
            )
        for limited in _limited_joints(robot, joint, joints, lower is None and upper is None):
            low, high = _limits(limited, lower, upper)
            if math.isinf(low) and math.isinf(high):
                raise ModelError(f"joint '{limited.name}' has no limits, give lower or upper")
            if not low < high:
                raise ModelError(
                    f"joint '{limited.name}': lower {low:g} must be less than upper {high:g}"
                )

    def quick_margin(self, q: Array, v: Array, a: Array) -> float:
        """Return the smallest g'' + kd g' + kp g of all stops, which is positive if none acts.

        Args:
            q: Configuration of all joints, shape (nq,).
            v: Velocity, shape (nv,).
            a: Acceleration without the stops, shape (nv,).
        """
        if self._has_bases:
            q, v, a = q[self._all_q], v[self._all_v], a[self._all_v]
        self._q_row[:] = q
        self._v_row[:] = v
        self._a_row[:] = a
        self._combine(self._margin_terms, self._margins)
        return self._item(self._smallest())

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return the gap of every joint to its nearer stop [rad or m], shape (m,)."""
        q = x.q[self._q]
        gap: Array = k.choose(*self._predicted_gaps(x), q - self._lower, self._upper - q)
        return gap

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return rows with 1 (lower stop) or -1 (upper stop) at their joint, shape (m, nv)."""
        J = k.zeros((len(self.rows), self._nv))
        J[self._row_indices, self._columns] = k.choose(*self._predicted_gaps(x), 1.0, -1.0)
        return J

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return zeros, shape (m,)."""
        return self._zero

    def _predicted_gaps(self, x: State) -> tuple[Array, Array]:
        """Return g + 2 T g' of lower and upper stops; the stop with the smaller value counts."""
        ahead = x.q[self._q] + self._lookahead * x.v[self._v]
        return ahead - self._lower, self._upper - ahead


def _limited_joints(
    robot: Robot, joint: str | None, joints: Sequence[str] | None, by_description: bool
) -> list[Joint]:
    """Return the joints that an entry names.

    Args:
        by_description: Whether [all] means the joints with limits in the robot description.
    """
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


def _limits(joint: Joint, lower: float | None, upper: float | None) -> tuple[float, float]:
    return joint.lower if lower is None else lower, joint.upper if upper is None else upper


def _multiplier_name(joint: Joint, count: int) -> str:
    """Return the name of the multiplier of one of `count` joints."""
    suffix = "" if count == 1 else f"_{joint.name.replace('.', '_')}"
    return f"{joint.effort_name}{suffix}"


def _as_slice(indices: list[int]) -> slice | Array:
    """Return consecutive indices as a slice, which costs a third of an index array."""
    first, last = indices[0], indices[0] + len(indices)
    return slice(first, last) if indices == list(range(first, last)) else np.array(indices)


def _margin_terms(robot: Robot, limited: list[Joint], limits: list[tuple[float, float]]) -> Array:
    """Return rows for q, v and a (filled later), lower and upper limits, shape (5, joints)."""
    rows = np.zeros((5, len(robot.joints)))
    rows[3], rows[4] = -_FAR, _FAR
    for joint, (lower, upper) in zip(limited, limits, strict=True):
        column = robot.joints.index(joint)
        rows[3, column], rows[4, column] = max(lower, -_FAR), min(upper, _FAR)
    return rows
