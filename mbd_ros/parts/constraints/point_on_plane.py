"""A point that stays on a plane."""

from typing import Annotated

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.frame_rows import PairRows, check_normal, plane_of


class PointOnPlane(PairRows):
    """Frictionless guide that keeps a point of one link in a plane of another: g = n . (p - p0).

    The plane moves with its link. A positive multiplier pushes the point along the normal and the
    plane in the opposite direction. The constraint is bilateral: the point cannot lift off.

    Args:
        frame: Link (or frame) of the point.
        plane_frame: Link (or frame) of the plane.
        normal: Normal of the plane in `plane_frame`, of any length, shape (3,).
        point: Guided point in `frame`, shape (3,).
        plane_point: Any point of the plane in `plane_frame`, shape (3,).

    Raises:
        ModelError: Unknown frame, or two frames without relative motion.
    """

    example = {"frame": "heel", "plane_frame": "world", "normal": [0.1, 0.0, 1.0]}
    check = staticmethod(check_normal)

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        plane_frame: str,
        normal: Annotated[Vector, Unit("-")],
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        plane_point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
    ) -> None:
        plane = plane_of(robot, robot.point(plane_frame, plane_point), normal)
        pair = robot.pair(plane, robot.point(frame, point))
        super().__init__(pair, "z")
        self.rows = (Row("force", "N", plane_frame),)
