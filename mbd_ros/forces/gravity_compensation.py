"""Torque that carries the weight of the robot."""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Load
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

ALL = "all"


class GravityCompensation(Load):
    """tau = factor g(q) on the named joints, g being the torque that holds the robot still.

    It knows the masses exactly and needs no time to act. Nothing acts on a free base. Its work
    does not count as stored energy.

    Args:
        robot: Robot of the scene.
        joints: Joints that are compensated; `[all]` for every joint.
        factor: Share of the weight that is carried.

    Raises:
        ModelError: No joint, an unknown or repeated one, or a factor that is no number.
    """

    example = {"factor": 0.9}

    def __init__(
        self, robot: Robot, *, joints: Sequence[str] = (ALL,), factor: float = 1.0
    ) -> None:
        if not math.isfinite(factor):
            raise ModelError(f"factor {factor:g} must be finite")
        every = [joint.name for joint in robot.joints]
        names = every if list(joints) == [ALL] and ALL not in every else list(joints)
        if not names or len(set(names)) != len(names):
            raise ModelError(f"joints {list(joints)} must be [{ALL}] or different joints")
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._gain = np.zeros(int(robot.model.nv))
        self._gain[[robot.joint(name).v for name in names]] = factor

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau: Array = self._gain * pin.computeGeneralizedGravity(self._model, self._data, x.q)
        return tau
