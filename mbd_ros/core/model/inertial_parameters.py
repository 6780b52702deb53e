"""The ten inertial parameters of every moving body, and their physical consistency.

A body consists of all links that move together. Forces are linear in its parameters, which are
taken about the origin, and in the axes, of its joint:

    m, m c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz,   I = I_c + m (c'c E - c c')

The parameters are physically consistent if the pseudo-inertia
P = [[tr(I)/2 E - I, m c], [m c', m]] is positive definite.

Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, IEEE Robot. Autom. Lett. 3, 2018, 60 (P).
"""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

COUNT = 10  # parameters per body
PARAMETER_NAMES = ("mass", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_MOMENTS = {4: (0, 0), 5: (0, 1), 6: (1, 1), 7: (0, 2), 8: (1, 2), 9: (2, 2)}


class Body(NamedTuple):
    """A moving body: all links that are fixed to each other.

    Attributes:
        name: Name of its heaviest link, or of the first one if none has mass.
        joint: Index of its joint in the model.
        links: Its links, starting with `name`.
    """

    name: str
    joint: int
    links: tuple[str, ...]


def moving_bodies(robot: Robot) -> tuple[Body, ...]:
    """Return the moving bodies in the order of the joints of the model."""
    links: dict[int, list[str]] = {j: [] for j in range(1, robot.model.njoints)}
    for frame in robot.model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint:
            links[int(frame.parentJoint)].append(frame.name)
    inertias, bodies = robot.inertias(), []
    for joint, names in links.items():
        masses = [inertias[name].mass if name in inertias else 0.0 for name in names]
        first = names[int(np.argmax(masses))]
        bodies.append(Body(first, joint, (first, *(name for name in names if name != first))))
    return tuple(bodies)


def parameters_of(model: Any) -> Array:
    """Return the inertial parameters of all bodies of a Pinocchio model, shape (bodies, 10)."""
    inertias = [model.inertias[j] for j in range(1, model.njoints)]
    parameters = [inertia.toDynamicParameters() for inertia in inertias]
    return np.array(parameters).reshape(-1, COUNT)


def pseudo_inertia(parameters: Array) -> Array:
    """Return the pseudo-inertia P of a body, shape (4, 4), which is linear in its parameters.

    Args:
        parameters: Inertial parameters, shape (10,).
    """
    m, h, I = parameters[0], parameters[1:4], np.zeros((3, 3))  # noqa: E741, the field's name
    for index, (i, j) in _MOMENTS.items():
        I[i, j] = I[j, i] = parameters[index]
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(I) * np.eye(3) - I
    P[:3, 3] = P[3, :3] = h
    P[3, 3] = m
    return P


def is_consistent(parameters: Array) -> bool:
    """Whether a body of positive density can have these parameters, shape (10,)."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters))[0] > 0.0)


def inertia_of(parameters: Array) -> Any:
    """Return the `pinocchio.Inertia` of parameters of shape (10,) whose mass is not 0."""
    return pin.Inertia.FromDynamicParameters(parameters)


def parameter_transformation(placement: Any) -> Array:
    """Return the matrix B, shape (10, 10), that expresses parameters in other axes: p' = B p.

    It follows from P' = H P H'.

    Args:
        placement: `pinocchio.SE3` of the old axes in the new ones, H as a matrix.
    """
    H = np.asarray(placement.homogeneous)
    columns = [
        parameters_of_pseudo_inertia(H @ pseudo_inertia(unit) @ H.T) for unit in np.eye(COUNT)
    ]
    return np.array(columns).T


def parameters_of_pseudo_inertia(P: Array) -> Array:
    """Return the parameters of a pseudo-inertia, shape (10,): the inverse of `pseudo_inertia`."""
    moments = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    tensor = [moments[i, j] for i, j in _MOMENTS.values()]
    return np.array([P[3, 3], *P[:3, 3], *tensor])
