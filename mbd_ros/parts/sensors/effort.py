"""Torque or force sensor in a joint."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor, reactions_of
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Effort(Sensor):
    """Torque (or force) that the parent link exerts on the child link along the joint axis.

    It is the sum of drive, friction, springs and tendons without the torque that accelerates the
    rotor of the drive, as a sensor at the output of the gear measures it.

    Args:
        joint: Joint that contains the sensor.
        noise: Standard deviation.
        offset: Measured value without load.
        label: Name in recordings and messages; by default the name of the sensor.
        delay: Time from a measurement to its message.
    """

    example = {"joint": "ankle", "noise": 0.05}
    level = Measures.FORCE

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        noise: Annotated[NotNegative, Unit("N·m or N")] = 0.05,
        offset: Annotated[float, Unit("N·m or N")] = 0.0,
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.joint = robot.joint(joint)
        self.noise = noise
        self.offset = offset
        self.label = label
        self.delay = delay
        self.frame = joint
        self.unit = self.joint.effort_unit
        self._row = [j.name for j in robot.joints].index(joint)
        self._axis = robot.axis(self.joint)

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the effort in the joint [N·m or N], shape (1,)."""
        return np.array((reactions_of(self, now)[self._row].dot(self._axis) + self.offset,))

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the noise [(N·m)^2 or N^2], shape (1, 1)."""
        return np.array(((self.noise**2,),))
