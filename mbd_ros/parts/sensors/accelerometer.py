"""Accelerometer on a link."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor, specific_force
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State


class Accelerometer(Sensor):
    """Accelerometer: specific force R' (a - g) at a point of a link, in the axes of the link.

    At rest it measures 9.81 m/s^2 upwards. Offset and measuring range are left out.

    Args:
        frame: Link (or frame) in whose axes it measures.
        xyz: Position in `frame`, shape (3,).
        noise: Standard deviation of each component.
        label: Name in recordings and messages; by default the name of the sensor.
        delay: Time from a measurement to its message.
    """

    example = {"frame": "foot", "noise": 0.05}
    level = Measures.ACCELERATION
    reads = Reads.DRIFT
    unit = "m/s^2"
    components = ("x", "y", "z")

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        xyz: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        noise: Annotated[NotNegative, Unit("m/s^2")] = 0.05,
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.point = robot.point(frame, xyz)
        self.frame = frame
        self.xyz: Sequence[float] = xyz
        self.noise = noise
        self.label = label
        self.delay = delay
        self._gravity = robot.model.gravity.linear.copy()

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the specific force in the axes of the link [m/s^2], shape (3,)."""
        return specific_force(self, k, self.point, now, self._gravity)

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative with respect to joint accelerations, shape (3, nv)."""
        return k.rotation(self.point).T.dot(k.jacobian(self.point))

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance, equal for all axes [(m/s^2)^2], shape (3, 3)."""
        return self.noise**2 * np.eye(3)
