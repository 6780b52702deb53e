"""Force or torque on a link whose magnitude is an input."""

import math
from typing import Annotated, Literal

import numpy as np

from mbd_ros.core.contracts import Channel, Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Positive, Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_SHORTEST = 1.0e-9


class BodyForce(Load):
    """Force u at a point of a link along a direction, or torque u about that direction.

    A torque can act between two links. Inertia and delay of the actuator are left out.

    Args:
        frame: Link (or frame) that the load acts on.
        direction: Direction of the force, or axis of the torque, of any length.
        kind: Meaning of the input: `force` [N] or `torque` [N·m].
        point: Point of `frame` at which a force acts, shape (3,).
        expressed_in: Axes of `direction`: those of `frame`, or `world`.
        against: Link (or frame) that the opposite torque acts on; none by default.
        limit: Largest force or torque; unlimited by default.

    Raises:
        ModelError: Unknown frame, a direction of no length, or links that do not move.
    """

    reads = Reads.JACOBIAN
    example = {"frame": "foot", "direction": [0.0, 0.0, 1.0], "point": [0.1, 0.0, 0.0]}

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        direction: Annotated[Vector, Unit("-")],
        kind: Literal["force", "torque"] = "force",
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        expressed_in: Literal["frame", "world"] = "frame",
        against: str | None = None,
        limit: Annotated[Positive, Unit("N or N·m")] = math.inf,
    ) -> None:
        self._point = robot.point(frame, point)
        self._other = None if against is None else robot.point(against)
        length = float(np.linalg.norm(direction))
        if length < _SHORTEST:
            raise ModelError(f"direction {list(direction)} has no length")
        if not (self._point.moves or (self._other is not None and self._other.moves)):
            raise ModelError(f"frame '{frame}' cannot move, so a load on it has no effect")
        along, none = np.array(direction) / length, np.zeros(3)
        is_torque = kind == "torque"
        self._direction = np.concatenate((none, along) if is_torque else (along, none))
        self._follows_link = expressed_in == "frame"
        self._limit = limit
        self.inputs = (Channel("", "N·m" if is_torque else "N", -limit, limit),)

    @staticmethod
    def check(kind: str, against: str | None) -> None:
        """Refuse a force between two links."""
        if against is not None and kind == "force":
            raise ModelError(
                "against is accepted with kind: torque only; use a path_force for a force between "
                "two links"
            )

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau: Array = self._generalized_direction(k) * self._magnitude(k, u)
        return tau

    def columns(self, k: Kinematics, x: State) -> Array:
        """Return the generalized force of 1 N or 1 N·m, shape (nv, 1)."""
        columns: Array = self._generalized_direction(k).reshape(-1, 1)
        return columns

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the wrenches on its one or two links."""
        axes = k.rotation(self._point) if self._follows_link else np.eye(3)
        load, at = self._direction * self._magnitude(k, u), k.position(self._point)
        force, torque = axes.dot(load[:3]), axes.dot(load[3:])
        wrench = Wrench(self._point.frame, at, force, torque)
        if self._other is None:
            return (wrench,)
        return wrench, Wrench(self._other.frame, at, -force, -torque)

    def _magnitude(self, k: Kinematics, u: Array) -> float:
        """Return the input within its limit [N or N·m]."""
        magnitude = u[self.u]
        if self._limit < math.inf:
            magnitude = k.within(magnitude, -self._limit, self._limit)
        return k.item(magnitude, 0)

    def _generalized_direction(self, k: Kinematics) -> Array:
        """Return J' times the direction, summed over both links, shape (nv,)."""
        jacobian = k.local_jacobian if self._follows_link else k.spatial_jacobian
        tau: Array = k.dot(self._direction, jacobian(self._point))
        if self._other is None:
            return tau
        direction = self._direction
        if self._follows_link:
            direction = k.transform_wrench(direction, self._point, self._other)
        return tau - k.dot(direction, jacobian(self._other))
