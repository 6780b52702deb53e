"""Poses and velocities of free bodies, and rotations as vectors.

A pose is (x, y, z, qx, qy, qz, qw): the position of a body in the world [m] and its orientation.
A twist is the velocity of the body [m/s], then its angular velocity [rad/s], in the axes of the
body. Its acceleration is the derivative of the twist, which is not what an accelerometer measures.
A rotation vector has the direction of the axis of a rotation, and the length of its angle.

Source: J. Solà et al., A micro Lie theory for state estimation in robotics, 2018,
https://arxiv.org/abs/1812.01537, appendix B (rotation vectors).
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

POSE, TWIST = 7, 6
_FULL_TURN = 2.0 * math.pi
_SMALLEST_ANGLE = 1.0e-9  # [rad], below which a rotation has no axis
_UNIT = 1.0e-12  # error of a squared length below which a quaternion is not normalised


def world_pose(robot: Robot, coordinates: Array) -> Array:
    """Return poses in the world from coordinates of a free body, a new array, shape (.., 7).

    Args:
        robot: The robot.
        coordinates: The slice of the body in a configuration, shape (.., 7).
    """
    pose = coordinates.copy()
    pose[..., :3] += robot.origin
    return pose


def configuration_of(robot: Robot, pose: Array) -> Array:
    """Return the coordinates of a free body from its pose, the inverse of `world_pose`, (.., 7).

    Args:
        robot: The robot.
        pose: Pose in the world, with a quaternion of any length but 0, shape (.., 7).
    """
    q = pose.copy()
    q[..., :3] -= robot.origin
    square = (q[..., 3:] ** 2).sum(axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        q[..., 3:] = np.where(np.abs(square - 1.0) <= _UNIT, q[..., 3:], q[..., 3:] / square**0.5)
    return q


def twist_of(pose: Array, rate: Array) -> Array:
    """Return the twists of poses from the time derivatives of their coordinates, shape (n, 6).

    With the quaternion r, of any length: omega = 2 vec(r^-1 r'), v = R' p'.

    Args:
        pose: Poses, shape (n, 7).
        rate: Their time derivatives, shape (n, 7).

    Source: Siciliano et al., Robotics, 2009, sec. 3.7.3.
    """
    return np.concatenate(
        (_in_body_axes(pose, rate[:, :3]), 2.0 * _quaternion_rate(pose, rate)[:, :3]), axis=1
    )


def _in_body_axes(pose: Array, vectors: Array) -> Array:
    """Return vectors given in world axes in the axes of the bodies, shape (n, 3)."""
    square = (pose[:, 3:] ** 2).sum(axis=1, keepdims=True)
    u, s = pose[:, 3:6], pose[:, 6:]
    rotated: Array = vectors - 2.0 / square * np.cross(u, s * vectors - np.cross(u, vectors))
    return rotated


def _quaternion_rate(pose: Array, rate: Array) -> Array:
    """Return r^-1 r' of quaternions (x, y, z, w), shape (n, 4)."""
    u, s, du, ds = pose[:, 3:6], pose[:, 6:], rate[:, 3:6], rate[:, 6:]
    square = (pose[:, 3:] ** 2).sum(axis=1, keepdims=True)
    vector = s * du - ds * u - np.cross(u, du)
    scalar = s * ds + (u * du).sum(axis=1, keepdims=True)
    return np.concatenate((vector, scalar), axis=1) / square


def acceleration_of(pose: Array, rate: Array, second: Array) -> Array:
    """Return the time derivatives of the twists of poses, shape (n, 6).

    omega' = 2 vec(r^-1 r'' - (r^-1 r')^2), v' = R' p'' - omega x v.

    Args:
        pose: Poses, shape (n, 7).
        rate: Their time derivatives, shape (n, 7).
        second: Their second time derivatives, shape (n, 7).
    """
    w, twist = _quaternion_rate(pose, rate), twist_of(pose, rate)
    angular = 2.0 * (_quaternion_rate(pose, second)[:, :3] - 2.0 * w[:, 3:] * w[:, :3])
    linear = _in_body_axes(pose, second[:, :3]) - np.cross(twist[:, 3:], twist[:, :3])
    return np.concatenate((linear, angular), axis=1)


def rate_of(pose: Array, twist: Array) -> Array:
    """Return the time derivatives of poses from their twists, the inverse of `twist_of`, (n, 7).

    Args:
        pose: Poses, shape (n, 7).
        twist: Twists, shape (n, 6).
    """
    u, s, omega = pose[:, 3:6], pose[:, 6:], twist[:, 3:]
    vector = s * omega + np.cross(u, omega)
    scalar = -(u * omega).sum(axis=1, keepdims=True)
    linear = twist[:, :3] + 2.0 * np.cross(u, s * twist[:, :3] + np.cross(u, twist[:, :3]))
    return np.concatenate((linear, 0.5 * vector, 0.5 * scalar), axis=1)


def step_between(before: Array, pose: Array) -> Array:
    """Return the constant twist that moves one pose to another in unit time, shape (6,).

    Args:
        before: Initial pose, shape (7,).
        pose: Final pose, shape (7,).
    """
    step: Array = pin.log6(pin.XYZQUATToSE3(before).actInv(pin.XYZQUATToSE3(pose))).vector
    return step


def quaternion_vector(quaternion: Array) -> Array:
    """Return the rotation vector [rad] of a quaternion (x, y, z, w) of any length > 0, (3,)."""
    x, y, z, w = (quaternion / np.linalg.norm(quaternion)).tolist()
    return rotation_vector(pin.Quaternion(w, x, y, z).toRotationMatrix())


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector [rad] of a rotation matrix, of length up to pi, shape (3,)."""
    return np.asarray(pin.log3(R))


def with_continuous_signs(poses: Array) -> Array:
    """Choose the signs of the quaternions of a motion so that they change continuously.

    Args:
        poses: Poses in the order of time, shape (n, 7).
    """
    q = poses[:, 3:]
    flips = (q[1:] * q[:-1]).sum(axis=1) < 0.0
    signs = np.where(np.cumsum(np.concatenate(([False], flips))) % 2, -1.0, 1.0)
    if (signs > 0.0).all():
        return poses
    return np.concatenate((poses[:, :3], q * signs[:, None]), axis=1)


def nearest_rotation_vector(vector: Array, other: Array) -> Array:
    """Return the vector of the same rotation that is nearest to another, by adding full turns.

    Args:
        vector: Rotation vector [rad], shape (3,).
        other: Rotation vector [rad], shape (3,).
    """
    angle = float(np.linalg.norm(vector))
    if angle < _SMALLEST_ANGLE:
        return vector
    axis = vector / angle
    turns = round((float(axis.dot(other)) - angle) / _FULL_TURN)
    return vector + turns * _FULL_TURN * axis


def with_sign_of(before: Array, pose: Array) -> Array:
    """Return a pose with the sign of its quaternion chosen as in an earlier pose, shape (7,)."""
    if before[3:].dot(pose[3:]) < 0.0:
        pose = pose.copy()
        pose[3:] *= -1.0
    return pose


def rotation_vector_slope(R: Array) -> Array:
    """Return the derivative of the rotation vector by rotations about the local axes, (3, 3)."""
    return np.asarray(pin.Jlog3(R))


def vector_quaternion(vector: Array) -> Array:
    """Return the quaternion (x, y, z, w) of a rotation vector [rad], shape (4,)."""
    return np.array(pin.Quaternion(pin.exp3(vector)).coeffs())


def cross(a: Array, b: Array) -> Array:
    """Return the vector products a x b, shape (.., 3)."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    first = a1 * b2 - a2 * b1
    product = np.empty((*np.shape(first), 3), np.result_type(a.dtype, b.dtype))
    product[..., 0] = first
    product[..., 1] = a2 * b0 - a0 * b2
    product[..., 2] = a0 * b1 - a1 * b0
    return product


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products a . b, shape (..)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def lengths(vectors: Array) -> Array:
    """Return the lengths sqrt(v . v), shape (..)."""
    return np.asarray(np.sqrt(dot(vectors, vectors)))


def unit(vectors: Array) -> Array:
    """Return the vectors scaled to length 1; zero vectors stay zero."""
    length = lengths(vectors)[..., None]
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))
