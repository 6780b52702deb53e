"""A force or a torque on a link that is an input."""

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
    """Force u along a direction at a point of a link, or torque u about it.

    Another link may take the opposite torque. No inertia and no delay.

    Args:
        frame: Link (or frame) that carries the load.
        direction: Of the force, or axis of the torque, of any length.
        kind: What the input is: `force` [N] or `torque` [N·m].
        point: Where a force acts, in `frame`, shape (3,).
        expressed_in: Axes of the direction: those of `frame`, or `world`.
        against: Link (or frame) that takes the opposite torque; none by default.
        limit: Largest force or torque; without it there is none.

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
            raise ModelError(f"frame '{frame}' does not move, a load on it changes nothing")
        along, none = np.array(direction) / length, np.zeros(3)
        is_torque = kind == "torque"
        self._load = np.concatenate((none, along) if is_torque else (along, none))
        self._turns = expressed_in == "frame"
        self._limit = limit
        self.inputs = (Channel("", "N·m" if is_torque else "N", -limit, limit),)

    @staticmethod
    def check(kind: str, against: str | None) -> None:
        """Refuse a force that two links share."""
        if against is not None and kind == "force":
            raise ModelError("against goes with kind: torque; a path_force acts on two links")

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau: Array = self._slopes(k) * self._asked(k, u)
        return tau

    def columns(self, k: Kinematics, x: State) -> Array:
        """What 1 N or 1 N·m exerts on the joints, shape (nv, 1)."""
        columns: Array = self._slopes(k).reshape(-1, 1)
        return columns

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The load on each of its links."""
        axes = k.rotation(self._point) if self._turns else np.eye(3)
        load, at = self._load * self._asked(k, u), k.position(self._point)
        force, torque = axes.dot(load[:3]), axes.dot(load[3:])
        own = Wrench(self._point.frame, at, force, torque)
        if self._other is None:
            return (own,)
        return own, Wrench(self._other.frame, at, -force, -torque)

    def _asked(self, k: Kinematics, u: Array) -> float:
        asked = u[self.u]
        if self._limit < math.inf:
            asked = k.within(asked, -self._limit, self._limit)
        return k.item(asked, 0)

    def _slopes(self, k: Kinematics) -> Array:
        """J' along the direction, of both links, shape (nv,)."""
        jacobian = k.own_jacobian if self._turns else k.spatial_jacobian
        slopes: Array = k.dot(self._load, jacobian(self._point))
        if self._other is None:
            return slopes
        load = self._load
        if self._turns:
            load = k.carried(load, self._point, self._other)
        return slopes - k.dot(load, jacobian(self._other))
