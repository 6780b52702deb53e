"""Kinematics k: what a part asks of the mechanism, evaluated at one state."""

from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array


class Kinematics:
    """Kinematics over a Pinocchio `Data` that its owner refreshes.

    Args:
        robot: The robot.
        data: Its `Data`.
    """

    def __init__(self, robot: Robot, data: Any) -> None:
        self.robot, self.data = robot, data
        self._model, self._rest = robot.model, np.zeros(robot.model.nv)

    def refresh(self, q: Array, v: Array) -> None:
        """Placements, velocities, accelerations at zero joint acceleration, joint Jacobians."""
        pin.forwardKinematics(self._model, self.data, q, v, self._rest)
        pin.computeJointJacobians(self._model, self.data)
