"""Pose of a link, as a tracking system measures it."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.poses import (
    nearest_rotation_vector,
    rotation_vector,
    rotation_vector_slope,
)
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State


class Pose(Sensor):
    """Position of a point of a link in the world, then the orientation of the link.

    The orientation is a rotation vector, whose direction is the axis and whose length is the
    angle; messages contain a quaternion. The vector jumps where the angle passes pi, for which
    estimators compensate (`near`).

    Args:
        frame: Measured link (or frame).
        xyz: Measured point in `frame`, shape (3,).
        noise: Standard deviation of each component of the position.
        turn_noise: Standard deviation of the rotation about each axis.
        label: Topic of its messages; by default `~/pose/<name>`.
        delay: Time from a measurement to its message.
    """

    example = {"frame": "foot"}
    level = Measures.POSITION
    reads = Reads.JACOBIAN
    components = ("x", "y", "z", "rotation_x", "rotation_y", "rotation_z")
    noise_varies = True

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        xyz: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        noise: Annotated[NotNegative, Unit("m")] = 0.001,
        turn_noise: Annotated[NotNegative, Unit("rad")] = 0.005,
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.point = robot.point(frame, xyz)
        self.origin = robot.origin
        self.frame = frame
        self.xyz: Sequence[float] = xyz
        self.noise = noise
        self.turn_noise = turn_noise
        self.label = label
        self.delay = delay

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return position [m] and rotation vector [rad] in the world, shape (6,)."""
        position = k.position(self.point) + self.origin
        return np.concatenate((position, rotation_vector(k.rotation(self.point))))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative with respect to q, shape (6, nv)."""
        angular = k.local_jacobian(self.point)[3:]
        slope = rotation_vector_slope(k.rotation(self.point))
        return np.vstack((k.jacobian(self.point), slope.dot(angular)))

    def near(self, values: Array, expected: Array) -> Array:
        """Return the same pose with the rotation vector that is nearest to the expected one."""
        if not np.isfinite(values[3:]).all():
            return values
        return np.concatenate((values[:3], nearest_rotation_vector(values[3:], expected[3:])))

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the noise, equal for all axes [m^2, rad^2], shape (6, 6)."""
        R, slope = np.zeros((6, 6)), rotation_vector_slope(k.rotation(self.point))
        R[:3, :3] = self.noise**2 * np.eye(3)
        R[3:, 3:] = self.turn_noise**2 * slope.dot(slope.T)
        return R
