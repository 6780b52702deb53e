"""Encoder on a joint."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Encoder(Sensor):
    """Encoder: position of a joint. Resolution and backlash are left out.

    Args:
        joint: Measured joint.
        noise: Standard deviation.
        offset: Measured value at joint position 0.
        label: Name in recordings and messages; by default the name of the sensor.
        delay: Time from a measurement to its message.
    """

    example = {"joint": "ankle", "noise": 1.0e-4}
    is_linear = True
    level = Measures.POSITION

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        noise: Annotated[NotNegative, Unit("rad or m")] = 1.0e-4,
        offset: Annotated[float, Unit("rad or m")] = 0.0,
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.joint = robot.joint(joint)
        self.noise = noise
        self.offset = offset
        self.label = label
        self.delay = delay
        self.frame = joint
        self.unit = self.joint.position_unit
        self._row = np.zeros((1, int(robot.model.nv)))
        self._row[0, self.joint.v] = 1.0

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the position of the joint [rad or m], shape (1,)."""
        return np.array((x.q[self.joint.q] + self.offset,))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative with respect to q, shape (1, nv)."""
        return self._row

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the noise [rad^2 or m^2], shape (1, 1)."""
        return np.array(((self.noise**2,),))
