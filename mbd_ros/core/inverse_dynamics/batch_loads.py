"""External loads of many samples at once: their generalized forces, sum J' w."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.loads.external_wrench import ExternalWrench
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_BLOCK = 256  # samples whose Jacobians stay in the cache
_Poses = dict[int, tuple[Array, Array]]  # joint -> rotations and places in the world


class BatchLoads:
    """Generalized forces of measured loads on the bodies of a robot.

    A wrench about the origin of the world, in its axes, does the work w . J dq with the columns of
    Pinocchio's world Jacobian: those of the joints that carry its body count.

    Args:
        robot: The robot.
        wrenches: External loads, in the order in which `forces` takes their values.
    """

    def __init__(self, robot: Robot, wrenches: Sequence[ExternalWrench]) -> None:
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._loads = tuple(wrenches)
        places = robot.places.points
        self._abouts = [places[load.about.number] for load in self._loads]
        self._moving = sorted({place.joint for place in self._abouts} - {0})
        carriers = [places[load.carrier.number].joint for load in self._loads]
        self._columns = [_columns(robot.model, joint) for joint in carriers]

    def forces(self, q: Array, wrenches: Sequence[Array]) -> Array:
        """Sum of J' w.

        Args:
            q: Configurations, shape (nq, n).
            wrenches: One (n, 6) array for every load: force [N] then torque [N·m].

        Returns:
            Shape (nv, n).

        Raises:
            ModelError: Another number of values.
        """
        if len(wrenches) != len(self._loads):
            raise ModelError(f"{len(wrenches)} wrenches given, the scene has {len(self._loads)}")
        total: Array = np.zeros((self._model.nv, q.shape[1]))
        for start in range(0, q.shape[1], _BLOCK):
            rows = slice(start, start + _BLOCK)
            jacobians, poses = self._kinematics(q[:, rows])
            for k, values in enumerate(wrenches):
                world = self._in_world(k, values[rows], poses)
                part = np.einsum("ij,ijk->ki", world, jacobians)
                total[self._columns[k], rows] += part[self._columns[k]]
        return total

    def _kinematics(self, q: Array) -> tuple[Array, _Poses]:
        """World Jacobians, shape (n, 6, nv), and poses of the joints that loads are seen from."""
        n, data = q.shape[1], self._data
        jacobians = np.empty((n, 6, self._model.nv))
        poses = {joint: (np.empty((n, 3, 3)), np.empty((n, 3))) for joint in self._moving}
        jacobian, refresh = data.J, partial(pin.computeJointJacobians, self._model, data)
        for i, row in enumerate(np.ascontiguousarray(q.T)):
            refresh(row)
            jacobians[i] = jacobian
            for joint, (rotations, places) in poses.items():
                pose = data.oMi[joint]
                rotations[i], places[i] = pose.rotation, pose.translation
        return jacobians, poses

    def _in_world(self, k: int, values: Array, poses: _Poses) -> Array:
        """Values of a load about the origin of the world, 0 where its force is too small."""
        load, about = self._loads[k], self._abouts[k]
        if load.threshold > 0.0:
            acts = np.linalg.norm(values[:, :3], axis=1) > load.threshold
            values = np.where(acts[:, None], values, 0.0)
        values = _moved(values, about.at.rotation, about.at.translation)
        return _moved(values, *poses[about.joint]) if about.joint else values


def _moved(values: Array, rotation: Array, place: Array) -> Array:
    """Wrenches in the axes and about the origin that these place is seen from, shape (n, 6)."""
    force, torque = (
        np.einsum("...ij,...j->...i", rotation, part) for part in (values[:, :3], values[:, 3:])
    )
    return np.hstack([force, torque + np.cross(place, force)])


def _columns(model: Any, joint: int) -> NDArray[np.intp]:
    """Where in v the joints stand that move a joint."""
    moved = [model.joints[j] for j in model.supports[joint] if j]
    return np.array([i for one in moved for i in range(one.idx_v, one.idx_v + one.nv)], np.intp)
