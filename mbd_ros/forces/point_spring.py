"""Spring and damper between two points."""

from typing import Annotated

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Load, Wrench
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State


class PointSpring(Load):
    """Massless spring and damper between two points at the distance d.

        F = stiffness (d - length) + damping d',   tau = -F grad d

    It pulls the points together where F > 0 and pushes them apart where F < 0 (it does not go
    slack as a rope does). With d = 0 the line has no direction, and F is zero; only for `length` 0
    and without damping is that the limit of the forces nearby.

    Args:
        robot: Robot of the scene.
        frame_a: Link (or frame) of one end; the root link or `universe` for a point at rest.
        frame_b: Link (or frame) of the other end.
        point_a: End in `frame_a`, shape (3,).
        point_b: End in `frame_b`, shape (3,).
        stiffness: Of the spring.
        damping: Of the damper.
        length: Distance without spring force.

    Raises:
        ModelError: Unknown frame, or both ends on one body.
    """

    reads = Reads.JACOBIAN
    example = {"frame_a": "world", "frame_b": "foot", "stiffness": 200.0, "length": 0.1}

    def __init__(
        self,
        robot: Robot,
        *,
        frame_a: str,
        frame_b: str,
        point_a: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        point_b: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        stiffness: Annotated[NotNegative, Unit("N/m")] = 0.0,
        damping: Annotated[NotNegative, Unit("N·s/m")] = 0.0,
        length: Annotated[NotNegative, Unit("m")] = 0.0,
    ) -> None:
        a, b = robot.point(frame_a, point_a), robot.point(frame_b, point_b)
        robot.pair(a, b)  # refuses ends that do not move against each other
        self._a, self._b = sorted((a, b), key=lambda end: end.moves)  # at most a is at rest
        self._stiffness, self._damping, self._length = stiffness, damping, length

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        _, slope, pull = self._tension(k, x)
        tau: Array = slope * -pull
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Forces at the ends of the spring."""
        direction, _, pull = self._tension(k, x)
        force, free = direction * pull, np.zeros(3)
        return (
            Wrench(self._a.frame, k.position(self._a), force, free),
            Wrench(self._b.frame, k.position(self._b), -force, free),
        )

    def _tension(self, k: Kinematics, x: State) -> tuple[Array, Array, float]:
        """From end a to end b, rate of the distance with every joint, and F [N]."""
        line = k.position(self._b) - k.position(self._a)
        distance = k.hypot(line)
        direction = line / k.where(distance > 0.0, distance, 1.0)
        slope: Array = k.dot(direction, k.jacobian(self._b))
        if self._a.moves:
            slope = slope - k.dot(direction, k.jacobian(self._a))
        stretch = distance - self._length
        return direction, slope, self._stiffness * stretch + self._damping * k.dot(slope, x.v)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the spring, zero at its length [J]."""
        stretch = k.hypot(k.position(self._b) - k.position(self._a)) - self._length
        return 0.5 * self._stiffness * stretch * stretch
