"""A point that stays on a plane."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.pair_rows import PairRows
from mbd_ros.errors import ModelError


class PointOnPlane(PairRows):
    """Frictionless guide: g = n . (p - p0), a point of one link in a plane of another.

    The plane moves with its link. A positive multiplier pushes the point along the normal and the
    plane the other way. It holds from both sides.

    Args:
        robot: Robot of the scene.
        frame: Link (or frame) that carries the point.
        plane_frame: Link (or frame) that carries the plane.
        normal: Normal of the plane in `plane_frame`, of any length, shape (3,).
        point: The point in `frame`, shape (3,).
        plane_point: Any point of the plane in `plane_frame`, shape (3,).

    Raises:
        ModelError: Unknown frame, or frames that do not move against each other.
    """

    example = {"frame": "heel", "plane_frame": "world", "normal": [0.1, 0.0, 1.0]}

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
        along = np.array(normal, dtype=np.float64)
        along = along / np.abs(along).max()  # so that its square neither vanishes nor overflows
        plane = robot.point(plane_frame, plane_point)
        plane = robot.turned(plane, _turned(along / np.linalg.norm(along)))
        pair = robot.pair(plane, robot.point(frame, point))
        super().__init__(pair, "z")
        self.rows = (Row("force", "N", plane_frame),)

    @staticmethod
    def check(normal: Sequence[float]) -> None:
        """Refuse a normal that points nowhere.

        Raises:
            ModelError: Names it.
        """
        if not any(normal):
            raise ModelError(f"normal {normal} must have a direction")


def _turned(normal: np.ndarray) -> np.ndarray:
    """A rotation whose z axis is the normal."""
    x = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = x - normal * normal.dot(x)
    x /= np.linalg.norm(x)
    a, b, c = normal.tolist()
    across = np.array(((0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0)))
    return np.column_stack((x, across.dot(x), normal))
