"""Closed chain: a frame on one body held to a frame on another."""

from typing import Annotated, Literal

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.rows.frame_rows import AxisRotation, FullRotation, PairRows, RotationResidual


class LoopClosure(PairRows):
    """Joint that closes a loop: frame b, seen in the axes of frame a, stays where a is.

        g = R_a' (p_b - p_a), then 2 sin(theta / 2) along the axis of the rotation that is left

    The rotational rows are exact up to 180 degrees and do not vanish there, so that a mechanism is
    not assembled upside down; at 180 degrees itself the way back is arbitrary. Multipliers are
    force and torque on b in the axes of a, at the origin of b. With fewer `directions` the origins
    may part along the others: `xy` for a planar loop, and with `revolute` about z for a
    cylindrical joint.

    Args:
        frame_a: Link (or frame) that carries frame a, whose axes the rows stand in.
        frame_b: Link (or frame) that carries frame b.
        point_a: Origin of a in `frame_a`, shape (3,).
        rpy_a: Axes of a in `frame_a`, roll, pitch, yaw, shape (3,).
        point_b: Origin of b in `frame_b`, shape (3,).
        rpy_b: Axes of b in `frame_b`, roll, pitch, yaw, shape (3,).
        kind: `point`: free to turn; `revolute`: turns about `axis`, which both frames share;
            `full`: does not turn.
        directions: Axes of a along which the origins must not part: x, y, z, xy, xz, yz or xyz.
        axis: Axis of a `revolute` closure: x, y or z.

    Raises:
        ModelError: Unknown frame, or frames that do not move against each other.
    """

    example = {"frame_a": "world", "point_a": [0.1, 0.0, 0.0], "frame_b": "foot", "kind": "full"}

    def __init__(
        self,
        robot: Robot,
        *,
        frame_a: str,
        frame_b: str,
        point_a: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        rpy_a: Annotated[Vector, Unit("rad")] = (0.0, 0.0, 0.0),
        point_b: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        rpy_b: Annotated[Vector, Unit("rad")] = (0.0, 0.0, 0.0),
        kind: Literal["point", "revolute", "full"] = "point",
        directions: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz",
        axis: Literal["x", "y", "z"] = "z",
    ) -> None:
        rotation: RotationResidual | None = None
        if kind != "point":
            rotation = FullRotation() if kind == "full" else AxisRotation(axis)
        a, b = robot.point(frame_a, point_a, rpy_a), robot.point(frame_b, point_b, rpy_b)
        super().__init__(robot.pair(a, b), directions, rotation)
