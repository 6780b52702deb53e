"""Torque that carries the weight of the robot."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

ALL = "all"


class GravityCompensation(Load):
    """Ideal gravity compensation: tau = factor g(q) on the named joints.

    g is the torque that holds the robot still. The compensation uses the exact masses and acts
    without delay. It exerts nothing on a floating base. Its work does not count as stored energy.

    Args:
        joints: Compensated joints, or `[all]`.
        factor: Fraction of the weight that is carried.

    Raises:
        ModelError: No joint, or an unknown or repeated one.
    """

    example = {"factor": 0.9}

    def __init__(
        self,
        robot: Robot,
        *,
        joints: Sequence[str] = (ALL,),
        factor: Annotated[float, Unit("-")] = 1.0,
    ) -> None:
        every = [joint.name for joint in robot.joints]
        names = every if list(joints) == [ALL] and ALL not in every else list(joints)
        if not names or len(set(names)) != len(names):
            raise ModelError(f"joints {list(joints)} must be [{ALL}] or different joints")
        selection = np.zeros(int(robot.model.nv))
        selection[[robot.joint(name).v for name in names]] = 1.0
        self._gain = selection * factor

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau: Array = self._gain * k.gravity(x.q)
        return tau
