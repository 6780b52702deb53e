"""Kinematics of many configurations: arrays over all of them in place of calls for each."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

Samples = NDArray[np.intp] | NDArray[np.bool_]


class SampledKinematics:
    """Places and Jacobians of the joints that carry points, at n configurations.

    Args:
        q: Configurations, shape (n, nq).
        joints: Indices of the joints that carry what is asked for.
        search: Finds paths that wrap, as `wrapping.taut.taut` does, from path, points and places.
    """

    def __init__(
        self, robot: Robot, q: Array, joints: NDArray[np.intp], search: Any = None
    ) -> None:
        self.search = search
        self._robot = robot
        self.q = q
        self._joints = joints
        n, model = len(q), robot.model
        self._columns = [_supporting(model, joint) for joint in joints]
        self._jacobians = np.empty((n, 6, model.nv))
        self._places = np.empty((n, len(joints), 4, 4))
        data = pin.Data(model)
        carriers = [(data.oMi[int(joint)], i) for i, joint in enumerate(joints)]  # live views
        for row, jacobian, places in zip(q, self._jacobians, self._places, strict=True):
            jacobian[:] = pin.computeJointJacobians(model, data, row).reshape(6, -1)
            for place, i in carriers:
                places[i] = place.homogeneous
        self._index = {int(joint): i for i, joint in enumerate(joints)}

    def of(self, samples: Samples) -> "SampledKinematics":
        """The same at some of the configurations."""
        part = object.__new__(SampledKinematics)
        part.__dict__.update(self.__dict__)
        part.q, part._jacobians = self.q[samples], self._jacobians[samples]
        part._places = self._places[samples]
        return part

    def position(self, point: Point, offset: Array | None = None) -> Array:
        """Where points are, less `Robot.origin` [m], shape (n, 3).

        Args:
            offset: From it in the axes of its joint [m], shape (n, 3); None: 0.
        """
        joint, at = self._robot.places.points[point.number]
        local = at.translation if offset is None else at.translation + offset
        if joint == 0:
            return np.asarray(np.broadcast_to(local, (len(self.q), 3)))
        place = self._places[:, self._index[joint]]
        if offset is None:
            return np.asarray(place[:, :3, :3] @ local + place[:, :3, 3])
        return np.asarray((place[:, :3, :3] @ local[..., None])[..., 0] + place[:, :3, 3])

    def rotation(self, point: Point) -> Array:
        """From the axes of a point to those of the world, shape (n, 3, 3)."""
        joint, at = self._robot.places.points[point.number]
        if joint == 0:
            return np.asarray(np.broadcast_to(at.rotation, (len(self.q), 3, 3)))
        return np.asarray(self._places[:, self._index[joint], :3, :3] @ at.rotation)

    def along(self, point: Point, vector: Array) -> Array:
        """Vectors in the axes of the joint of a point, in those of the world, shape (n, 3)."""
        joint = self._robot.places.points[point.number].joint
        if joint == 0:
            return np.asarray(np.broadcast_to(vector, (len(self.q), 3)))
        turn = self._places[:, self._index[joint], :3, :3]
        return np.asarray((turn @ vector[..., None])[..., 0])

    def carrier(self, point: Point) -> int:
        """Index of the joint that carries a point, 0 at rest."""
        return int(self._robot.places.points[point.number].joint)

    def slope(self, wrenches: Mapping[int, Array]) -> Array:
        """Generalized forces of wrenches on what joints carry, shape (n, nv).

        Args:
            wrenches: Joint -> force and torque about the origin of the world, shape (n, 6).
        """
        whole = np.zeros((len(self.q), self._robot.model.nv))
        for joint, wrench in wrenches.items():
            if joint:
                columns = self._columns[self._index[joint]]
                whole[:, columns] += (wrench[:, None, :] @ self._jacobians[:, :, columns])[:, 0]
        return whole


def carriers(robot: Robot) -> NDArray[np.intp]:
    """Indices of the joints that carry points of parts."""
    joints = {int(place.joint) for place in robot.places.points} - {0}
    return np.array(sorted(joints), dtype=np.intp)


def _supporting(model: object, joint: int) -> NDArray[np.intp]:
    """Velocity coordinates that move a joint."""
    found: list[int] = []
    for one in model.supports[int(joint)]:  # type: ignore[attr-defined]
        if one:
            of = model.joints[one]  # type: ignore[attr-defined]
            found += range(of.idx_v, of.idx_v + of.nv)
    return np.array(found, dtype=np.intp)
