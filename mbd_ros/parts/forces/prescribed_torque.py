"""Joint torques that follow a table over time."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.inputs import between_samples
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit
from mbd_ros.core.state import Array, State, is_symbol
from mbd_ros.errors import ModelError


class PrescribedTorque(Load):
    """Joint torques from a table over time: linear between samples, zero outside of the table.

    Args:
        joints: Joints that the torques act on.
        times: Times of the samples, increasing, at least two.
        torque: Torques, one row per sample and one column per joint.
    """

    example = {"joints": ["knee"], "times": [0.0, 1.0], "torque": [[1.0], [5.0]]}

    def __init__(
        self,
        robot: Robot,
        *,
        joints: Sequence[str],
        times: Annotated[Sequence[float], Unit("s")],
        torque: Annotated[Sequence[Sequence[float]], Unit("N·m or N")],
    ) -> None:
        self._times = np.array(times, dtype=np.float64)
        self._torque = np.array(torque, dtype=np.float64)
        self._index = [robot.joint(name).v for name in joints]
        self._nv = int(robot.model.nv)

    @staticmethod
    def check(
        joints: Sequence[str], times: Sequence[float], torque: Sequence[Sequence[float]]
    ) -> None:
        """Refuse times that do not increase, and rows and columns that do not match."""
        if len(times) < 2 or not (np.diff(times) > 0).all():
            raise ModelError("times must be at least two increasing numbers")
        if len(torque) != len(times) or any(len(row) != len(joints) for row in torque):
            raise ModelError(
                f"torque must have {len(times)} rows (one per time) of {len(joints)} numbers "
                "(one per joint)"
            )

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force at the time of the state, shape (nv,)."""
        tau, times = k.zeros(self._nv), self._times
        if is_symbol(x.t):
            tau[self._index] = between_samples(x.t, times, self._torque)
        elif times[0] <= x.t <= times[-1]:
            i = min(int(np.searchsorted(times, x.t, side="right")), len(times) - 1)
            share = (x.t - times[i - 1]) / (times[i] - times[i - 1])
            tau[self._index] = self._torque[i - 1] + share * (
                self._torque[i] - self._torque[i - 1]
            )
        return tau
