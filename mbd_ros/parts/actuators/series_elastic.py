"""Motor with a spring between gear and joint."""

import math
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Actuator, Channel
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Unit
from mbd_ros.core.state import Array, State


class SeriesElastic(Actuator):
    """Spring to a commanded position: tau = stiffness (u - q) - damping v, at most `limit`.

    The motor side follows its command at once and with any force; its inertia, speed and torque
    limits are left out, and so is the velocity of the command in the damping.

    Args:
        joint: Driven joint; its command is the motor-side end of the spring, as a position of
            the joint [rad or m].
        stiffness: Of the spring.
        damping: Of the joint.
        limit: Largest torque or force of the joint, damping included; without it there is none.
    """

    takes = "position of the motor side of the spring [rad or m]"
    example = {"joint": "ankle", "stiffness": 300.0, "damping": 1.0, "limit": 100.0}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        stiffness: Annotated[Positive, Unit("N·m/rad or N/m")],
        damping: Annotated[NotNegative, Unit("N·m·s/rad or N·s/m")] = 0.0,
        limit: Annotated[Positive, Unit("N·m or N")] = math.inf,
    ) -> None:
        self.joint = robot.joint(joint)
        self.joints = (joint,)
        self.inputs = (Channel("", self.joint.position_unit),)
        self._stiffness = stiffness
        self._damping = damping
        self._limit = limit
        self._nv = int(robot.model.nv)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,), of the commanded position [rad or m], shape (1,)."""
        tau = k.zeros(self._nv)
        stretch = k.item(u, self.u.start or 0) - k.item(x.q, self.joint.q)
        wanted = self._stiffness * stretch - self._damping * k.item(x.v, self.joint.v)
        tau[self.joint.v] = k.maximum(k.minimum(wanted, self._limit), -self._limit)
        return tau

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """The stiffness, shape (nv, 1); None with a limit, which depends on the position."""
        if self._limit < math.inf:
            return None
        columns = np.zeros((self._nv, 1))
        columns[self.joint.v] = self._stiffness
        return columns

    def command(self, torque: Array, x: State) -> Array:
        """Motor-side end of the spring that gives the torque, shape (1,)."""
        wanted = torque + self._damping * x.v[self.joint.v]
        return x.q[self.joint.q] + wanted / self._stiffness

    def limits(self) -> Array:
        """`limit` of the joint [N·m or N], shape (1,)."""
        return np.array([self._limit])
