"""A robot that some force could move without resistance is refused."""

import numpy as np

from mbd_ros.core.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_TINY = 1.0e-300
_SINGULAR = 1.0e-16  # smallest eigenvalue of a mass matrix with ones on its diagonal
_SHARE = 0.1  # of the base in the motion without mass, from which on the base is to blame


def check_mass(robot: Robot, M: Array) -> None:
    """Refuse a singular mass matrix.

    Args:
        robot: The robot.
        M: Its mass matrix at some configuration, shape (nv, nv).

    Raises:
        ModelError: Names the joint, or the floating base.
    """
    size = np.sqrt(np.maximum(M.diagonal(), _TINY))
    values, vectors = np.linalg.eigh(M / size[:, None] / size)
    if len(M) == 0 or values[0] > _SINGULAR * len(M):
        return
    massless = np.abs(vectors[:, 0])
    names = {joint.v: f"joint '{joint.name}'" for joint in robot.joints}
    name = names.get(int(np.argmax(massless)), "the floating base")
    if robot.floating and massless[:6].max() > _SHARE:
        name = "the floating base"
    raise ModelError(
        f"{name} moves nothing that has mass: the mass matrix is singular, so forward dynamics "
        "has no answer; give its link an <inertial>"
    )
