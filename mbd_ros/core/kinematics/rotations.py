"""Rotations as vectors along their axis, as long as their angle.

Source: J. Solà et al., A micro Lie theory for state estimation in robotics, 2018,
https://arxiv.org/abs/1812.01537, appendix B.
"""

import math

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array

_TURN = 2.0 * math.pi
_NONE = 1.0e-9  # rad, below which a rotation has no axis


def rotation_vector(R: Array) -> Array:
    """Rotation vector [rad] of a rotation matrix, no longer than pi, shape (3,)."""
    return np.asarray(pin.log3(R))


def rotation_vector_slope(R: Array) -> Array:
    """Change of the rotation vector by a rotation of R in its own axes, shape (3, 3)."""
    return np.asarray(pin.Jlog3(R))


def nearest_rotation_vector(vector: Array, other: Array) -> Array:
    """The vector of the same rotation, by whole turns more or less, that is nearest to another.

    Args:
        vector: Rotation vector [rad], shape (3,).
        other: Rotation vector [rad], shape (3,).
    """
    angle = float(np.linalg.norm(vector))
    if angle < _NONE:
        return vector
    axis = vector / angle
    turns = round((float(axis.dot(other)) - angle) / _TURN)
    return vector + turns * _TURN * axis


def quaternion_vector(quaternion: Array) -> Array:
    """Rotation vector [rad] of a quaternion (x, y, z, w) of any length > 0, shape (3,)."""
    x, y, z, w = (quaternion / np.linalg.norm(quaternion)).tolist()
    return rotation_vector(pin.Quaternion(w, x, y, z).toRotationMatrix())


def vector_quaternion(vector: Array) -> Array:
    """Quaternion (x, y, z, w) of a rotation vector [rad], shape (4,)."""
    return np.array(pin.Quaternion(pin.exp3(vector)).coeffs())
