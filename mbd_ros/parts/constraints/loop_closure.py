"""Joint that closes a kinematic loop between two bodies."""

from typing import Annotated, Literal

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.rows.frame_rows import AxisRotation, FullRotation, PairRows, RotationResidual


class LoopClosure(PairRows):
    """Loop-closing joint: frame b of one body coincides with frame a of another one.

        g = R_a' (p_b - p_a), then 2 sin(theta / 2) along the axis of the remaining rotation theta

    The rotational rows are exact up to 180 degrees and do not vanish there, so a mechanism is
    never assembled upside down; at exactly 180 degrees the direction of correction is arbitrary.
    The multipliers are the force and torque on b, in the axes of a, at the origin of b. With fewer
    `directions` the origins can move apart along the remaining axes: `xy` suits a planar loop, and
    together with `revolute` about z it is a cylindrical joint.

    Args:
        frame_a: Link (or frame) that frame a is fixed to; rows are expressed in the axes of a.
        frame_b: Link (or frame) that frame b is fixed to.
        point_a: Origin of a in `frame_a`, shape (3,).
        rpy_a: Axes of a in `frame_a` as roll, pitch, yaw, shape (3,).
        point_b: Origin of b in `frame_b`, shape (3,).
        rpy_b: Axes of b in `frame_b` as roll, pitch, yaw, shape (3,).
        kind: `point` leaves all rotations free, `revolute` the rotation about `axis`, and `full`
            none.
        directions: Axes of a along which the origins coincide: x, y, z, xy, xz, yz or xyz.
        axis: Common axis of both frames of a `revolute` closure: x, y or z.

    Raises:
        ModelError: Unknown frame, or two frames without relative motion.
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
