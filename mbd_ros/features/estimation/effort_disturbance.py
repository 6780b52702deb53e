"""Efforts that nobody measures, as states of an estimator."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts.parts import Internal, Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State


class EffortDisturbance(Load):
    """An unknown effort on each of some joints: tau = z, z' = 0 but for noise.

    Efforts that drift have rates, which are states too: z' = r, r' = 0 but for noise.

    Args:
        robot: Robot of the scene.
        joints: Where they act.
        drifting: Whether they have rates; these stand behind the efforts.

    Raises:
        ModelError: Unknown joint.
    """

    def __init__(self, robot: Robot, joints: Sequence[str], *, drifting: bool = False) -> None:
        found = [robot.joint(name) for name in joints]
        self.name, self.joints = "disturbance", tuple(joints)
        efforts = [
            Internal(j.name, j.effort_unit, initial=0.0, is_constant=not drifting) for j in found
        ]
        rates = [
            Internal(f"{j.name}_rate", f"{j.effort_unit}/s", initial=0.0, is_constant=True)
            for j in found
        ]
        self.internal = (*efforts, *(rates if drifting else ()))
        self.drifting, self._count = drifting, len(found)
        self._v, self._nv = np.array([j.v for j in found], dtype=np.intp), int(robot.model.nv)
        self._still = np.zeros(len(self.internal))

    @property
    def efforts(self) -> slice:
        """Where the efforts stand in z."""
        return slice(self.z.start, self.z.start + self._count)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force [N·m or N], shape (nv,)."""
        tau, efforts = k.zeros(self._nv), x.z[self.z]
        tau[self._v] = efforts[: self._count] if self.drifting else efforts
        return tau

    def constant_slopes(self, nv: int, nz: int) -> Array | None:
        """Ones by the efforts, shape (nv, 2 nv + nz); None where these drift."""
        if self.drifting:
            return None
        slopes = np.zeros((nv, 2 * nv + nz))
        slopes[self._v, 2 * nv + np.arange(nz)[self.z]] = 1.0
        return slopes

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Of the efforts, and nothing of their rates, shape (len(internal),)."""
        if not self.drifting:
            return self._still
        found = np.zeros(len(self.internal))
        found[: self._count] = x.z[self.z][self._count :]
        return found
