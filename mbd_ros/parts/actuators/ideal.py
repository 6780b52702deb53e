"""Ideal motors, whose torque is their command."""

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Actuator, Channel
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Positive, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class Ideal(Actuator):
    """Ideal drives: tau = u, at most `limit` in either direction.

    Inertia, friction and delay are left out.

    Args:
        joints: Driven joints; every joint has one command [N·m or N], in this order.
        limit: Largest torque or force of every joint; unlimited by default. Effort limits of the
            robot description are ignored.

    Raises:
        ModelError: No joint, or an unknown or repeated one.
    """

    example = {"joints": ["knee", "ankle"], "limit": 100.0}

    def __init__(
        self,
        robot: Robot,
        *,
        joints: Sequence[str],
        limit: Annotated[Positive, Unit("N·m or N")] = math.inf,
    ) -> None:
        if not joints or len(set(joints)) != len(joints):
            raise ModelError(f"joints {list(joints)} must be one or more different joints")
        self.joints = tuple(joints)
        self._v = np.array([robot.joint(name).v for name in joints])
        self._limit = limit
        self._nv = int(robot.model.nv)
        self._columns = np.zeros((self._nv, len(joints)))
        self._columns[self._v, np.arange(len(joints))] = 1.0
        units = [robot.joint(name).effort_unit for name in joints]
        names = joints if len(joints) > 1 else ("",)
        self.inputs = tuple(
            Channel(name, unit, -limit, limit) for name, unit in zip(names, units, strict=True)
        )

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau, u = k.zeros(self._nv), u[self.u]
        if self._limit < math.inf:
            u = k.within(u, -self._limit, self._limit)
        tau[self._v] = u
        return tau

    def constant_slopes(self, nv: int, nz: int) -> Array:
        """Return zeros, shape (nv, 2 nv + nz): the force depends on the commands only."""
        return np.zeros((nv, 2 * nv + nz))

    def columns(self, k: Kinematics, x: State) -> Array:
        """Return the selection matrix of the joints, shape (nv, len(joints)); do not modify it."""
        return self._columns

    def limits(self) -> Array:
        """Return `limit` of every joint [N·m or N], shape (len(joints),)."""
        return np.full(len(self.joints), self._limit)
