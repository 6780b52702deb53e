"""Constant torque on a joint."""

from typing import Annotated

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit
from mbd_ros.core.state import Array, State


class JointTorque(Load):
    """Constant torque on a joint, or force on a prismatic one: tau = torque.

    Args:
        joint: Joint that the torque acts on.
        torque: Torque or force, positive along the joint axis.
    """

    example = {"joint": "ankle", "torque": 5.0}

    def __init__(
        self, robot: Robot, *, joint: str, torque: Annotated[float, Unit("N·m or N")]
    ) -> None:
        self.joint = robot.joint(joint)
        self._torque = torque
        self._nv = int(robot.model.nv)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau = k.zeros(self._nv)
        tau[self.joint.v] = self._torque
        return tau

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the potential energy -torque q, zero at q = 0 [J]."""
        return -self._torque * k.item(x.q, self.joint.q)
