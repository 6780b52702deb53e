"""The ten inertial numbers of every body that moves: names, values, and what a body can have.

A body is all links that move together. Its numbers, about the origin of its joint and in the axes
of that, are those in which forces are linear:

    m, m c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz,   I = I_c + m (c'c E - c c')

The pseudo-inertia P = [[tr(I)/2 E - I, m c], [m c', m]] of a body is positive definite.

Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, IEEE Robot. Autom. Lett. 3, 2018, 60 (P).
"""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

COUNT = 10  # numbers a body
PARAMETER_NAMES = ("mass", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_MOMENTS = {4: (0, 0), 5: (0, 1), 6: (1, 1), 7: (0, 2), 8: (1, 2), 9: (2, 2)}


class Body(NamedTuple):
    """A body that moves.

    Attributes:
        name: The heaviest of its links, or the one that its joint carries.
        joint: Index in the model.
        links: All links that move with that joint, the first of them `name`.
    """

    name: str
    joint: int
    links: tuple[str, ...]


def moving_bodies(robot: Robot) -> tuple[Body, ...]:
    """Bodies in the order of the joints of the model."""
    links: dict[int, list[str]] = {j: [] for j in range(1, robot.model.njoints)}
    for frame in robot.model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint:
            links[int(frame.parentJoint)].append(frame.name)
    given, bodies = robot.inertias(), []
    for joint, names in links.items():
        masses = [given[name].mass if name in given else 0.0 for name in names]
        first = names[int(np.argmax(masses))]
        bodies.append(Body(first, joint, (first, *(name for name in names if name != first))))
    return tuple(bodies)


def parameters_of(model: Any) -> Array:
    """The inertial numbers of all bodies of a Pinocchio model, shape (bodies, 10)."""
    inertias = [model.inertias[j] for j in range(1, model.njoints)]
    found = [inertia.toDynamicParameters() for inertia in inertias]
    return np.array(found).reshape(-1, COUNT)


def pseudo_inertia(parameters: Array) -> Array:
    """P of one body, shape (4, 4), of numbers of shape (10,); linear in them."""
    m, h, I = parameters[0], parameters[1:4], np.zeros((3, 3))  # noqa: E741, the field's name
    for place, (i, j) in _MOMENTS.items():
        I[i, j] = I[j, i] = parameters[place]
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(I) * np.eye(3) - I
    P[:3, 3] = P[3, :3] = h
    P[3, 3] = m
    return P


def is_consistent(parameters: Array) -> bool:
    """Whether one body of positive density can have these numbers, shape (10,)."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters))[0] > 0.0)


def inertia_of(parameters: Array) -> Any:
    """`pinocchio.Inertia` of numbers of shape (10,), mass not 0."""
    return pin.Inertia.FromDynamicParameters(parameters)


def parameter_transformation(placement: Any) -> Array:
    """Numbers in other axes, as a matrix: p' = B p with P' = H P H', shape (10, 10).

    Args:
        placement: `pinocchio.SE3` of the old axes in the new ones, H as a matrix.
    """
    H = np.asarray(placement.homogeneous)
    columns = [
        parameters_of_pseudo_inertia(H @ pseudo_inertia(unit) @ H.T) for unit in np.eye(COUNT)
    ]
    return np.array(columns).T


def parameters_of_pseudo_inertia(P: Array) -> Array:
    """Inverse of `pseudo_inertia`, shape (10,)."""
    moments = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    tensor = [moments[i, j] for i, j in _MOMENTS.values()]
    return np.array([P[3, 3], *P[:3, 3], *tensor])
