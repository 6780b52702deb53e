"""Free bodies of a robot between its coordinates and poses in the world, see `poses`."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

_UNIT = 1.0e-12  # of the square of a quaternion's length; closer ones keep their bits


def world_pose(robot: Robot, coordinates: Array) -> Array:
    """Pose in the world of a free body from its part of a configuration, fresh, shape (.., 7)."""
    pose = coordinates.copy()
    pose[..., :3] += robot.origin
    return pose


def configuration_of(robot: Robot, pose: Array) -> Array:
    """Coordinates of a free body, the inverse of `world_pose`; shape (.., 7).

    Args:
        robot: The robot.
        pose: In the world, of any length of the quaternion but 0, shape (.., 7).
    """
    q = pose.copy()
    q[..., :3] -= robot.origin
    square = (q[..., 3:] ** 2).sum(axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        q[..., 3:] = np.where(np.abs(square - 1.0) <= _UNIT, q[..., 3:], q[..., 3:] / square**0.5)
    return q


def step_between(before: Array, pose: Array) -> Array:
    """The twist that leads from one pose to another in a unit of time, shape (6,).

    Args:
        before: Shape (7,).
        pose: Shape (7,).
    """
    step: Array = pin.log6(pin.XYZQUATToSE3(before).actInv(pin.XYZQUATToSE3(pose))).vector
    return step


class IndependentCoordinates:
    """Where joints and free bodies stand among the independent coordinates y and their rates.

    Args:
        robot: The robot.
        couplings: Its dependent joints.

    Attributes:
        joint_y: Places of the independent joints in y.
        joint_w: Places of the independent joints in y'.
        body_y: Places of each free body in y, 7 each.
        body_w: Places of each free body in y', 6 each.
    """

    def __init__(self, robot: Robot, couplings: Couplings) -> None:
        joints, bases = [robot.joint(name) for name in couplings.independent], robot.bases
        q, v = couplings.q_index, couplings.v_index
        self.joint_y = np.searchsorted(q, np.array([joint.q for joint in joints], dtype=np.intp))
        self.joint_w = np.searchsorted(v, np.array([joint.v for joint in joints], dtype=np.intp))
        self.body_y = [np.searchsorted(q, np.arange(b.q.start, b.q.stop)) for b in bases]
        self.body_w = [np.searchsorted(v, np.arange(b.v.start, b.v.stop)) for b in bases]
        self._y = np.concatenate([self.joint_y, *self.body_y])
        self._w = np.concatenate([self.joint_w, *self.body_w])

    def positions(self, joints_and_bodies: Array) -> Array:
        """Coordinates y of joints, then bodies, shape (.., ny)."""
        return self._arranged(joints_and_bodies, self._y)

    def rates(self, joints_and_bodies: Array) -> Array:
        """Rates y' or y'' of joints, then bodies, shape (.., nv_y)."""
        return self._arranged(joints_and_bodies, self._w)

    def _arranged(self, values: Array, at: NDArray[np.intp]) -> Array:
        if not self.body_y:
            return values
        arranged = np.empty_like(values)
        arranged[..., at] = values
        return arranged
