"""Series elastic actuator whose motor follows a position command ideally."""

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

    The motor follows its position command instantly. Its inertia, its limits of speed and torque,
    and the velocity of the command in the damping are left out. `series_elastic_drive` models the
    motion of the motor.

    Args:
        joint: Driven joint; its command is the position of the motor side of the spring, expressed
            as a joint position [rad or m].
        stiffness: Stiffness of the spring.
        damping: Damping of the joint.
        limit: Largest torque or force of the joint, damping included; unlimited by default.
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
        """Return the generalized force, shape (nv,)."""
        tau = k.zeros(self._nv)
        stretch = k.item(u, self.u.start or 0) - k.item(x.q, self.joint.q)
        torque = self._stiffness * stretch - self._damping * k.item(x.v, self.joint.v)
        tau[self.joint.v] = k.maximum(k.minimum(torque, self._limit), -self._limit)
        return tau

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Return the stiffness, shape (nv, 1); None with a limit, which depends on q and v."""
        if self._limit < math.inf:
            return None
        columns = np.zeros((self._nv, 1))
        columns[self.joint.v] = self._stiffness
        return columns

    def command(self, torque: Array, x: State) -> Array:
        """Return the position of the motor side that exerts the torque [rad or m], shape (1,)."""
        spring_torque = torque + self._damping * x.v[self.joint.v]
        return x.q[self.joint.q] + spring_torque / self._stiffness

    def limits(self) -> Array:
        """Return `limit` [N·m or N], shape (1,)."""
        return np.array([self._limit])
