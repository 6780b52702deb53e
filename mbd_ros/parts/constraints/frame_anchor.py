"""A link that is fixed to the world."""

from collections.abc import Sequence
from typing import Annotated, Literal

from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.rows.frame_rows import FullRotation, PairRows
from mbd_ros.errors import ModelError


class FrameAnchor(PairRows):
    """Anchor that fixes a frame to the world; its rows are expressed in the axes of the world.

        g = p - position, then 2 sin(theta / 2) along the axis of the remaining rotation theta

    The multipliers are the force and torque on the link at the anchored point. The rotational
    rows are exact up to 180 degrees and do not vanish there.

    Args:
        frame: Link (or frame) that is anchored.
        position: Position of the anchored point in the world, shape (3,).
        point: Anchored point in `frame`, shape (3,).
        rpy: Anchored axes in `frame` as roll, pitch, yaw, shape (3,).
        orientation: Orientation of these axes in the world as roll, pitch, yaw, shape (3,).
        kind: `full` fixes position and orientation (six rows); `point` fixes the point only
            (three rows) and takes no `orientation`.

    Raises:
        ModelError: Unknown frame, or a frame that cannot move.
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
        anchor, anchored = robot.point("universe", position), robot.point(frame, point, rpy)
        if orientation is not None:
            R = rotation_matrix(orientation)
            anchored = robot.rotated(anchored, R.T)  # these axes coincide with those of the world
        super().__init__(
            robot.pair(anchor, anchored), "xyz", FullRotation() if kind == "full" else None
        )

    @staticmethod
    def check(orientation: Sequence[float] | None, kind: str) -> None:
        """Refuse kind `full` without an orientation, and kind `point` with one."""
        if (orientation is None) == (kind == "full"):
            raise ModelError(
                f"orientation must be {'given' if kind == 'full' else 'left out'} for kind {kind}"
            )
