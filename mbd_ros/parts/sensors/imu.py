"""Inertial measurement unit on a link: gyroscope and accelerometer."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor, specific_force
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State

_ANGULAR = slice(3, 6)  # of a spatial velocity


class Imu(Sensor):
    """IMU: angular velocity, then specific force R' (a - g), both in the axes of the link.

    At rest the specific force is 9.81 m/s^2 upwards. Bias drift is left out.

    Args:
        frame: Link (or frame) in whose axes it measures.
        xyz: Position in `frame`, shape (3,).
        gyro_noise: Standard deviation of each component of the angular velocity.
        acceleration_noise: Standard deviation of each component of the specific force.
        label: Topic of its messages; by default `~/imu/<name>`.
        delay: Time from a measurement to its message.
    """

    example = {"frame": "foot"}
    level = Measures.ACCELERATION
    reads = Reads.DRIFT
    components = (
        "angular_velocity_x",
        "angular_velocity_y",
        "angular_velocity_z",
        "linear_acceleration_x",
        "linear_acceleration_y",
        "linear_acceleration_z",
    )

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        xyz: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        gyro_noise: Annotated[NotNegative, Unit("rad/s")] = 0.01,
        acceleration_noise: Annotated[NotNegative, Unit("m/s^2")] = 0.05,
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.point = robot.point(frame, xyz)
        self.frame = frame
        self.xyz = xyz
        self.gyro_noise = gyro_noise
        self.acceleration_noise = acceleration_noise
        self.label = label
        self.delay = delay
        self._gravity = robot.model.gravity.linear.copy()

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the angular velocity [rad/s] and specific force [m/s^2], shape (6,)."""
        force = specific_force(self, k, self.point, now, self._gravity)
        return np.concatenate((k.local_jacobian(self.point)[_ANGULAR].dot(x.v), force))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative with respect to joint accelerations, shape (6, nv)."""
        by_a = k.rotation(self.point).T.dot(k.jacobian(self.point))
        return np.vstack((np.zeros_like(by_a), by_a))

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the noise [(rad/s)^2, (m/s^2)^2], shape (6, 6)."""
        noise = np.repeat((self.gyro_noise, self.acceleration_noise), 3)
        return np.diag(noise**2)
