"""A point that may touch a plane, with friction."""

from typing import Annotated

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector, Within
from mbd_ros.core.row_laws import cone
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.pair_rows import PairRows, check_normal, plane_of
from mbd_ros.core.state import Array, State


class PointContact(PairRows):
    """Contact of a point of one link with a plane of another: Signorini and Coulomb.

        g = n . (p - p0) >= 0,   normal >= 0,   |friction| <= mu normal, against the slip

    The plane moves with its link, and the point is free on the side that n points to. Multipliers
    push the point: along n, then along two tangents, x and y of the plane, which is isotropic.
    Static and kinetic friction are the same. An impact gives back a share of its compression.

    Args:
        robot: Robot of the scene.
        frame: Link (or frame) that carries the point.
        plane_frame: Link (or frame) that carries the plane.
        normal: Normal n of the plane in `plane_frame`, of any length, shape (3,).
        friction: Coefficient mu.
        restitution: Share of the impulse of a compression that its expansion gives back.
        point: The point in `frame`, shape (3,).
        plane_point: Any point of the plane in `plane_frame`, shape (3,).

    Raises:
        ModelError: Unknown frame, or frames that do not move against each other.
    """

    smoothed = False
    example = {
        **{"frame": "heel", "plane_frame": "world", "normal": [0.0, 0.0, 1.0]},
        **{"plane_point": [0.0, 0.0, -9.0], "friction": 0.5},
    }
    check = staticmethod(check_normal)

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        plane_frame: str,
        normal: Annotated[Vector, Unit("-")],
        friction: Annotated[NotNegative, Unit("-")],
        restitution: Annotated[float, Within(0.0, 1.0), Unit("-")] = 0.0,
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        plane_point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
    ) -> None:
        plane = plane_of(robot, plane_frame, plane_point, normal)
        super().__init__(robot.pair(plane, robot.point(frame, point)), "zxy")
        names = ("normal", "friction_x", "friction_y")
        self.rows = tuple(Row(name, "N", plane_frame) for name in names)
        self.law = cone(friction, restitution)

    def residual(self, k: Kinematics, x: State) -> Array:
        """The gap [m]; 0 along the tangents, where any place will do, shape (3,)."""
        return np.array((k.motion(self._pair).offset()[2], 0.0, 0.0))
