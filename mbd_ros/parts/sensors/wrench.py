"""Six-axis force and torque sensor in a joint."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Kind, Measures, Now, Sensor, reactions_of
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Wrench(Sensor):
    """Wrench that the parent link of a joint exerts on the child link.

    It is expressed in the axes of the child, about the origin of the joint. Its component along
    the joint axis is what `effort` measures.

    Args:
        joint: Joint that contains the sensor.
        force_noise: Standard deviation of each component of the force.
        torque_noise: Standard deviation of each component of the torque.
        label: Topic of its messages; by default `~/measured_wrench/<name>`.
        delay: Time from a measurement to its message.
    """

    example = {"joint": "ankle"}
    level = Measures.FORCE
    components = Kind.WRENCH.value

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        force_noise: Annotated[NotNegative, Unit("N")] = 0.5,
        torque_noise: Annotated[NotNegative, Unit("N·m")] = 0.05,
        label: str = "",
        delay: Annotated[NotNegative, Unit("s")] = 0.0,
    ) -> None:
        self.joint = robot.joint(joint)
        self.frame = joint
        self.force_noise = force_noise
        self.torque_noise = torque_noise
        self.label = label
        self.delay = delay
        self._row = [j.name for j in robot.joints].index(joint)

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the force [N], then the torque [N·m], shape (6,)."""
        return np.array(reactions_of(self, now)[self._row])

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the noise [N^2, (N·m)^2], shape (6, 6)."""
        return np.diag(np.repeat((self.force_noise, self.torque_noise), 3) ** 2)
