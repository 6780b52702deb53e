"""Unknown inputs of inverse dynamics: columns B, bounds, and what they cost."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.inputs import bound
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

Columns = Callable[[Kinematics, State], Array]


class Efforts(NamedTuple):
    """Inputs u that exert B u + rest on the joints.

    Where a motion does not determine them, those with the least sum of
    (weight (u - target))^2 are taken.

    Attributes:
        names: One a column; of efforts of joints the joints.
        columns: B at a state, shape (nv, n).
        lower: Smallest values, -inf without, shape (n,).
        upper: Largest values, inf without, shape (n,).
        weight: Of the cost [1 per unit of u], > 0, shape (n,).
        target: Of the cost, shape (n,).
        reads: What `columns` and `rest` read of k.
        rest: What they exert at u = 0, at a state, shape (nv,); None for nothing.
    """

    names: tuple[str, ...]
    columns: Columns
    lower: Array
    upper: Array
    weight: Array
    target: Array
    reads: Reads = Reads.NOTHING
    rest: Columns | None = None


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


def input_efforts(robot: Robot, loads: Sequence[Load]) -> Efforts:
    """Inputs of loads that are affine in them, within the bounds of their channels.

    Args:
        robot: The robot.
        loads: Actuators and other loads with inputs; they are no force terms of the problem then.

    Raises:
        ModelError: A load that is not affine in its inputs, or that has internal states.
    """
    parts, inputs = bound(loads)
    affine = [part for part in parts if isinstance(part, Load)]
    k, neutral = Kinematics(robot), State(0.0, robot.neutral(), np.zeros(int(robot.model.nv)))
    reads = max((part.reads for part in affine), default=Reads.NOTHING)
    k.refresh(neutral.q, neutral.v, reads)
    for part in affine:
        name = part.name or type(part).__name__
        if part.internal:
            raise ModelError(f"{name} has internal states, which a motion does not show")
        if part.columns(k, neutral) is None:
            raise ModelError(f"the force of {name} is not affine in its inputs")
    idle, n = np.zeros(len(inputs.names)), len(inputs.names)

    def columns(k: Kinematics, x: State) -> Array:
        none = np.zeros((len(x.v), 0))
        return np.concatenate([none, *(part.columns(k, x) for part in affine)], axis=1)

    def rest(k: Kinematics, x: State) -> Array:
        return np.sum([np.zeros(len(x.v)), *(part.force(k, x, idle) for part in affine)], axis=0)

    lower = np.array([channel.lower for channel in inputs.channels], dtype=np.float64)
    upper = np.array([channel.upper for channel in inputs.channels], dtype=np.float64)
    return Efforts(inputs.names, columns, lower, upper, np.ones(n), np.zeros(n), reads, rest)
