"""Constant torque on a joint."""

import math

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Load
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class JointTorque(Load):
    """Constant torque, or force on a prismatic joint: tau = torque.

    Args:
        robot: Robot of the scene.
        joint: Joint that it acts on.
        torque: Along the positive joint axis [N·m or N].

    Raises:
        ModelError: Unknown joint, or a torque that is no number.
    """

    example = {"joint": "ankle", "torque": 5.0}

    def __init__(self, robot: Robot, *, joint: str, torque: float) -> None:
        if not math.isfinite(torque):
            raise ModelError(f"torque {torque:g} must be finite")
        self.joint = robot.joint(joint)
        self._torque = torque
        self._tau = np.zeros(int(robot.model.nv))
        self._tau[self.joint.v] = torque

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau: Array = self._tau.copy()
        return tau

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy whose slope the torque is, zero at q = 0 [J]."""
        return -self._torque * float(x.q[self.joint.q])
