"""Six-axis force and torque sensor in a joint."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Kind, Measures, Now, Sensor, reactions_of
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Wrench(Sensor):
    """What the parent of a joint exerts on its child, about the origin and in axes of the joint.

    The axes are those of the child; along the axis of the joint it is what `effort` measures.

    Args:
        joint: Joint that it is in.
        force_noise: Standard deviation of each component of the force.
        torque_noise: Of each component of the torque.
        label: Topic of its messages; empty for `~/measured_wrench/<name>`.
        delay: From a measurement to its message.
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
        self._row = [one.name for one in robot.joints].index(joint)

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Force [N], then torque [N·m], shape (6,)."""
        return np.array(reactions_of(self, now)[self._row])

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Of the noise [N^2, (N·m)^2], shape (6, 6)."""
        return np.diag(np.repeat((self.force_noise, self.torque_noise), 3) ** 2)
