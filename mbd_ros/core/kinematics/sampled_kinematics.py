"""Kinematics of many configurations at once, as arrays over all configurations."""

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
    """Positions and Jacobians of points at n configurations.

    Args:
        robot: The robot.
        q: Configurations, shape (n, nq).
        joints: Indices of the joints that carry the points of interest.
        search: Function that finds the shortest path over wrapping surfaces from path, points and
            placements; needed for paths that wrap.
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
        self._placements = np.empty((n, len(joints), 4, 4))
        data = pin.Data(model)
        joint_poses = [(data.oMi[int(joint)], i) for i, joint in enumerate(joints)]  # live views
        for row, jacobian, placements in zip(q, self._jacobians, self._placements, strict=True):
            jacobian[:] = pin.computeJointJacobians(model, data, row).reshape(6, -1)
            for pose, i in joint_poses:
                placements[i] = pose.homogeneous
        self._index = {int(joint): i for i, joint in enumerate(joints)}

    def of(self, samples: Samples) -> "SampledKinematics":
        """Return the kinematics at a subset of the configurations."""
        subset = object.__new__(SampledKinematics)
        subset.__dict__.update(self.__dict__)
        subset.q = self.q[samples]
        subset._jacobians = self._jacobians[samples]
        subset._placements = self._placements[samples]
        return subset

    def position(self, point: Point, offset: Array | None = None) -> Array:
        """Return the positions of a point relative to `Robot.origin` [m], shape (n, 3).

        Args:
            point: The point.
            offset: Offset from the point in the axes of its joint [m], shape (n, 3); 0 by default.
        """
        joint, at = self._robot.places.points[point.number]
        local = at.translation if offset is None else at.translation + offset
        if joint == 0:
            return np.asarray(np.broadcast_to(local, (len(self.q), 3)))
        pose = self._placements[:, self._index[joint]]
        if offset is None:
            return np.asarray(pose[:, :3, :3] @ local + pose[:, :3, 3])
        return np.asarray((pose[:, :3, :3] @ local[..., None])[..., 0] + pose[:, :3, 3])

    def rotation(self, point: Point) -> Array:
        """Return the rotations from the axes of a point to those of the world, (n, 3, 3)."""
        joint, at = self._robot.places.points[point.number]
        if joint == 0:
            return np.asarray(np.broadcast_to(at.rotation, (len(self.q), 3, 3)))
        return np.asarray(self._placements[:, self._index[joint], :3, :3] @ at.rotation)

    def along(self, point: Point, vector: Array) -> Array:
        """Return vectors, given in the axes of the joint of a point, in world axes, (n, 3)."""
        joint = self._robot.places.points[point.number].joint
        if joint == 0:
            return np.asarray(np.broadcast_to(vector, (len(self.q), 3)))
        rotation = self._placements[:, self._index[joint], :3, :3]
        return np.asarray((rotation @ vector[..., None])[..., 0])

    def carrier(self, point: Point) -> int:
        """Return the index of the joint that carries a point, 0 for a fixed point."""
        return int(self._robot.places.points[point.number].joint)

    def slope(self, wrenches: Mapping[int, Array]) -> Array:
        """Return the generalized forces of wrenches, shape (n, nv).

        Args:
            wrenches: Index of a joint -> force and torque on its body about the origin of the
                world, shape (n, 6).
        """
        tau = np.zeros((len(self.q), self._robot.model.nv))
        for joint, wrench in wrenches.items():
            if joint:
                columns = self._columns[self._index[joint]]
                tau[:, columns] += (wrench[:, None, :] @ self._jacobians[:, :, columns])[:, 0]
        return tau


def carriers(robot: Robot) -> NDArray[np.intp]:
    """Return the indices of the joints that carry points of parts."""
    joints = {int(place.joint) for place in robot.places.points} - {0}
    return np.array(sorted(joints), dtype=np.intp)


def _supporting(model: object, joint: int) -> NDArray[np.intp]:
    """Return the velocity coordinates that move a joint."""
    coordinates: list[int] = []
    for i in model.supports[int(joint)]:  # type: ignore[attr-defined]
        if i:
            support = model.joints[i]  # type: ignore[attr-defined]
            coordinates += range(support.idx_v, support.idx_v + support.nv)
    return np.array(coordinates, dtype=np.intp)
