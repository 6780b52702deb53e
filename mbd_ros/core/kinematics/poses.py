"""Poses of free bodies and their velocities, one a row.

A pose is (x, y, z, qx, qy, qz, qw): place of the frame of the body in the world [m], and its
orientation. A twist is its velocity [m/s], then its angular velocity [rad/s], in axes of the body.
An acceleration is the derivative of the twist, not what an accelerometer feels.
"""

import numpy as np

from mbd_ros.core.state import Array

POSE, TWIST = 7, 6


def with_sign_of(before: Array, pose: Array) -> Array:
    """A pose whose quaternion has the sign of an earlier one, shape (7,)."""
    if before[3:].dot(pose[3:]) < 0.0:
        pose = pose.copy()
        pose[3:] *= -1.0
    return pose


def with_steady_signs(poses: Array) -> Array:
    """Poses in the order of time, each quaternion of the sign of the one before.

    Args:
        poses: Shape (n, 7).
    """
    q = poses[:, 3:]
    turns = (q[1:] * q[:-1]).sum(axis=1) < 0.0
    signs = np.where(np.cumsum(np.concatenate(([False], turns))) % 2, -1.0, 1.0)
    if (signs > 0.0).all():
        return poses
    return np.concatenate((poses[:, :3], q * signs[:, None]), axis=1)


def twist_of(pose: Array, rate: Array) -> Array:
    """Twists of poses from the rates of their seven numbers, shape (n, 6).

    With the quaternion r, of any length: omega = 2 vec(r^-1 r'), v = R' p'.

    Args:
        pose: Shape (n, 7).
        rate: Its derivative in time, shape (n, 7).

    Source: Siciliano et al., Robotics, 2009, sec. 3.7.3.
    """
    return np.concatenate(
        (_turned_back(pose, rate[:, :3]), 2.0 * _turns(pose, rate)[:, :3]), axis=1
    )


def acceleration_of(pose: Array, rate: Array, second: Array) -> Array:
    """Derivatives of the twists of `twist_of`, shape (n, 6).

    omega' = 2 vec(r^-1 r'' - (r^-1 r')^2), v' = R' p'' - omega x v.

    Args:
        pose: Shape (n, 7).
        rate: Its derivative in time, shape (n, 7).
        second: Its second derivative, shape (n, 7).
    """
    w, twist = _turns(pose, rate), twist_of(pose, rate)
    angular = 2.0 * (_turns(pose, second)[:, :3] - 2.0 * w[:, 3:] * w[:, :3])
    linear = _turned_back(pose, second[:, :3]) - np.cross(twist[:, 3:], twist[:, :3])
    return np.concatenate((linear, angular), axis=1)


def rate_of(pose: Array, twist: Array) -> Array:
    """Rates of the seven numbers of poses, the inverse of `twist_of`, shape (n, 7).

    Args:
        pose: Shape (n, 7).
        twist: Shape (n, 6).
    """
    u, s, omega = pose[:, 3:6], pose[:, 6:], twist[:, 3:]
    vector = s * omega + np.cross(u, omega)
    scalar = -(u * omega).sum(axis=1, keepdims=True)
    linear = twist[:, :3] + 2.0 * np.cross(u, s * twist[:, :3] + np.cross(u, twist[:, :3]))
    return np.concatenate((linear, 0.5 * vector, 0.5 * scalar), axis=1)


def _turns(pose: Array, rate: Array) -> Array:
    """r^-1 r' of quaternions (x, y, z, w), shape (n, 4)."""
    u, s, du, ds = pose[:, 3:6], pose[:, 6:], rate[:, 3:6], rate[:, 6:]
    square = (pose[:, 3:] ** 2).sum(axis=1, keepdims=True)
    vector = s * du - ds * u - np.cross(u, du)
    scalar = s * ds + (u * du).sum(axis=1, keepdims=True)
    return np.concatenate((vector, scalar), axis=1) / square


def _turned_back(pose: Array, vectors: Array) -> Array:
    """Vectors of the world in axes of the bodies, shape (n, 3)."""
    square = (pose[:, 3:] ** 2).sum(axis=1, keepdims=True)
    u, s = pose[:, 3:6], pose[:, 6:]
    turned: Array = vectors - 2.0 / square * np.cross(u, s * vectors - np.cross(u, vectors))
    return turned
