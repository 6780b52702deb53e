"""Tachometer on a joint."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Tachometer(Sensor):
    """Tachometer: velocity of a joint.

    Args:
        joint: Measured joint.
        noise: Standard deviation.
        label: Name in recordings and messages; by default the name of the sensor.
        delay: Time from a measurement to its message.
    """

    example = {"joint": "ankle", "noise": 0.01}
    is_linear = True
    level = Measures.VELOCITY

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        noise: Annotated[NotNegative, Unit("rad/s or m/s")] = 0.01,
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.joint = robot.joint(joint)
        self.noise = noise
        self.label = label
        self.delay = delay
        self.frame = joint
        self.unit = f"{self.joint.position_unit}/s"
        self._row = np.zeros((1, int(robot.model.nv)))
        self._zeros = np.zeros_like(self._row)
        self._row[0, self.joint.v] = 1.0

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the velocity of the joint [rad/s or m/s], shape (1,)."""
        return np.array((x.v[self.joint.v],))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative with respect to v, shape (1, nv)."""
        return self._row

    def by_position(self, k: Kinematics, x: State) -> Array:
        """Return zeros, shape (1, nv)."""
        return self._zeros

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the noise [(rad/s)^2 or (m/s)^2], shape (1, 1)."""
        return np.array(((self.noise**2,),))
