"""Poses and velocities of bodies as a scene writes them."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.ranges import Length, Unit, Vector
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.schema import schema

_SMALLEST = 1.0e-6  # length of a quaternion that still says which way to turn
_Quaternion = Annotated[Sequence[float], Length(4), Unit("x, y, z, w")]


def read_pose(given: Any, where: str) -> Array:
    """A pose `{xyz: [..], rpy: [..]}` or `{xyz: [..], quaternion: [x, y, z, w]}`.

    Args:
        given: What the file holds; what it leaves out is 0.
        where: File and key, for the messages.

    Returns:
        Position [m], then the quaternion (x, y, z, w) of length 1, shape (7,).

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    pose: Array = schema.call(_pose, given, where, where)
    return pose


def _pose(
    where: str,
    *,
    xyz: Vector = (0.0, 0.0, 0.0),
    rpy: Vector | None = None,
    quaternion: _Quaternion | None = None,
) -> Array:
    if quaternion is None:
        turn = pin.Quaternion(rotation_matrix(rpy or (0.0, 0.0, 0.0))).coeffs()
        return np.concatenate((xyz, turn))
    if rpy is not None:
        raise SceneError(f"{where}: give either 'rpy' or 'quaternion'")
    turn = np.array(quaternion)
    length = float(np.linalg.norm(turn))
    if length < _SMALLEST:
        raise SceneError(f"{where}.quaternion: {quaternion} says no rotation, expected length 1")
    return np.concatenate((xyz, turn / length))


def read_twist(given: Any, where: str, rotation: Array) -> Array:
    """A velocity `{linear: [..], angular: [..], expressed_in: body}`.

    Args:
        given: What the file holds; what it leaves out is 0.
        where: File and key, for the messages.
        rotation: Of the axes of the body in the world, shape (3, 3).

    Returns:
        Velocity of the body's origin [m/s], then of its axes [rad/s], in its own axes, shape (6,).

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    twist: Array = schema.call(_twist, given, where, rotation)
    return twist


def _twist(
    rotation: Array,
    *,
    linear: Vector = (0.0, 0.0, 0.0),
    angular: Vector = (0.0, 0.0, 0.0),
    expressed_in: Literal["body", "world"] = "body",
) -> Array:
    axes = np.eye(3) if expressed_in == "body" else rotation.T
    return np.concatenate((axes.dot(linear), axes.dot(angular)))
