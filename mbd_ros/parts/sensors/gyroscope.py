"""Gyroscope on a link."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State

_ANGULAR = slice(3, 6)  # of a spatial velocity


class Gyroscope(Sensor):
    """Gyroscope: angular velocity of a link, in the axes of the link.

    Args:
        frame: Link (or frame) in whose axes it measures.
        noise: Standard deviation of each component.
        offset: Measured value at rest, shape (3,).
        label: Name in recordings and messages; by default the name of the sensor.
        delay: Time from a measurement to its message.
    """

    example = {"frame": "foot", "noise": 0.01}
    level = Measures.VELOCITY
    reads = Reads.JACOBIAN
    unit = "rad/s"
    components = ("x", "y", "z")

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        noise: Annotated[NotNegative, Unit("rad/s")] = 0.01,
        offset: Annotated[Vector, Unit("rad/s")] = (0.0, 0.0, 0.0),
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.point = robot.point(frame)
        self.frame = frame
        self.noise = noise
        self.offset: Sequence[float] = offset
        self.label = label
        self.delay = delay

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the angular velocity in the axes of the link [rad/s], shape (3,)."""
        return self.jacobian(k, x).dot(x.v) + np.array(self.offset)

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative with respect to v [rad/s per unit of v], shape (3, nv)."""
        return k.local_jacobian(self.point)[_ANGULAR]

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance, equal for all axes [(rad/s)^2], shape (3, 3)."""
        return self.noise**2 * np.eye(3)
