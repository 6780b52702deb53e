"""Spring and damper between two points."""

from typing import Annotated

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.point_path import path_through
from mbd_ros.core.kinematics.paths.via_point import ViaPoint
from mbd_ros.core.loads.path_load import PathLoad
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State


class PointSpring(PathLoad):
    """Massless spring and damper between two points at distance d.

        F = stiffness (d - length) + damping d',   tau = -F grad d

    The spring pulls the points together where F > 0 and pushes them apart where F < 0; it does
    not become slack as a cable does. At d = 0 the line has no direction, and F is set to zero,
    which is continuous only if `length` and `damping` are 0.

    Args:
        frame_a: Link (or frame) of one end; the root link or `universe` for a fixed point.
        frame_b: Link (or frame) of the other end.
        point_a: End a in `frame_a`, shape (3,).
        point_b: End b in `frame_b`, shape (3,).
        stiffness: Stiffness of the spring.
        damping: Damping coefficient.
        length: Distance at which the spring exerts no force.

    Raises:
        ModelError: Unknown frame, or both ends on one body.
    """

    outputs = ()
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
        ends = ViaPoint(robot, frame_a, point_a), ViaPoint(robot, frame_b, point_b)
        super().__init__(path_through(robot, sorted(ends, key=lambda end: end.moves)))
        self._stiffness = stiffness
        self._damping = damping
        self._length = length

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """Return F [N], which is negative where the spring pushes."""
        return self._stiffness * (length - self._length) + self._damping * speed

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of the spring [J]."""
        stretch = self.path.length(k, x) - self._length
        return 0.5 * self._stiffness * stretch * stretch
