"""Unknown inputs of inverse dynamics: columns B, bounds, and what they cost."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

Columns = Callable[[Kinematics, State], Array]


class Efforts(NamedTuple):
    """Inputs u that exert B u on the joints.

    Where a motion does not determine them, those with the least sum of
    (weight (u - target))^2 are taken.

    Attributes:
        names: One a column; of efforts of joints the joints.
        columns: B at a state, shape (nv, n).
        lower: Smallest values, -inf without, shape (n,).
        upper: Largest values, inf without, shape (n,).
        weight: Of the cost [1 per unit of u], > 0, shape (n,).
        target: Of the cost, shape (n,).
        reads: What `columns` reads of k.
    """

    names: tuple[str, ...]
    columns: Columns
    lower: Array
    upper: Array
    weight: Array
    target: Array
    reads: Reads = Reads.NOTHING


def joint_efforts(
    robot: Robot, joints: Sequence[str], limits: Sequence[float] | None = None
) -> Efforts:
    """Efforts of joints [N·m or N], of smallest Euclidean norm in SI numbers.

    Args:
        robot: The robot.
        joints: Different joints of it.
        limits: Largest effort of each [N·m or N], > 0; without it there is none.

    Raises:
        ModelError: Unknown or repeated joint, or a limit that is not positive.
    """
    names, n = tuple(joints), len(joints)
    if len(set(names)) < n:
        raise ModelError(f"actuated joints {', '.join(names)} must be different joints")
    B = np.zeros((int(robot.model.nv), n))
    B[[robot.joint(name).v for name in names], range(n)] = 1.0
    upper = np.full(n, np.inf) if limits is None else np.array(limits, dtype=np.float64)
    if upper.shape != (n,) or not (upper > 0.0).all():
        raise ModelError(f"limits {upper.tolist()} must be one number > 0 for each of {n} joints")
    return Efforts(names, lambda k, x: B, -upper, upper, np.ones(n), np.zeros(n))
