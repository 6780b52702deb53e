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
    """tau = factor g(q) on the named joints, g being the torque that holds the robot still.

    It knows the masses exactly and needs no time to act. Nothing acts on a free base. Its work
    does not count as stored energy.

    Args:
        joints: Joints that are compensated; `[all]` for every joint.
        factor: Share of the weight that is carried.

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
        chosen = np.zeros(int(robot.model.nv))
        chosen[[robot.joint(name).v for name in names]] = 1.0
        self._gain = chosen * factor

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau: Array = self._gain * k.gravity(x.q)
        return tau
