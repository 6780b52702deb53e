"""A link held at a place in the world."""

from collections.abc import Sequence
from typing import Annotated, Literal

from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.rows.frame_rows import FullRotation, PairRows
from mbd_ros.errors import ModelError


class FrameAnchor(PairRows):
    """Holds a frame at a place in the world, in world axes.

        g = p - position, then 2 sin(theta / 2) along the axis of the rotation that is left

    Multipliers are force and torque on the link at the anchored point. The rotational rows are
    exact up to 180 degrees and do not vanish there.

    Args:
        frame: Link (or frame) that is held.
        position: Where its point is held, in the world, shape (3,).
        point: The point in `frame`, shape (3,).
        rpy: Axes of the held frame in `frame`, roll, pitch, yaw, shape (3,).
        orientation: How these axes are held in the world, roll, pitch, yaw, shape (3,).
        kind: `full`: six rows; `point`: free to turn, three rows, without `orientation`.

    Raises:
        ModelError: Unknown frame, or one that does not move.
    """

    example = {
        "frame": "foot",
        "position": [0.1, 0.006, 0.1],
        "orientation": [0.0, 0.2, 0.0],
        "kind": "full",
    }

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        position: Annotated[Vector, Unit("m")],
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        rpy: Annotated[Vector, Unit("rad")] = (0.0, 0.0, 0.0),
        orientation: Annotated[Vector | None, Unit("rad")] = None,
        kind: Literal["full", "point"] = "full",
    ) -> None:
        place, held = robot.point("universe", position), robot.point(frame, point, rpy)
        if orientation is not None:
            wanted = rotation_matrix(orientation)
            held = robot.turned(held, wanted.T)  # has the axes of the world
        super().__init__(
            robot.pair(place, held), "xyz", FullRotation() if kind == "full" else None
        )

    @staticmethod
    def check(orientation: Sequence[float] | None, kind: str) -> None:
        """Refuse an orientation of a frame that is free to turn, and none of one that is not."""
        if (orientation is None) == (kind == "full"):
            raise ModelError("orientation goes with kind full, which cannot do without it")
