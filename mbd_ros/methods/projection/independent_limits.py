"""Limits of dependent joints, as limits of the independent coordinates that they follow.

An independent joint may go as far as the joints that follow it stay within their own limits: the
interval around 0 is found on a grid over its range, and its ends by bisection.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

_SAMPLES = 2001  # of a coupling, over the range of its parent
_WIDE = 4.0 * np.pi  # rad or m: range of a parent without limits
_HALVINGS = 50
_SLACK = 1.0e-9  # rad or m by which a dependent joint may pass its limit
Bools = NDArray[np.bool_]


def independent_limits(robot: Robot, couplings: Couplings) -> tuple[Array, Array]:
    """Range of the independent coordinates in which all joints are within limits.

    Returns:
        Smallest and largest values [rad or m], shapes (ny,) and (ny,); infinite for free bodies.
    """
    nv = robot.model.nv
    low, high = np.full(nv, -np.inf), np.full(nv, np.inf)
    for joint in robot.joints:
        low[joint.v], high[joint.v] = joint.lower, joint.upper
    followed = {pair.parent_v for pair in couplings.pairs} & set(couplings.v_index.tolist())
    for v in sorted(followed):
        low[v], high[v] = _room(robot, couplings, v, low, high)
    return low[couplings.v_index], high[couplings.v_index]


def _room(
    robot: Robot, couplings: Couplings, v: int, low: Array, high: Array
) -> tuple[float, float]:
    """The interval of one independent joint around 0 in which its dependents keep limits.

    Without any such interval their limits have no say.
    """
    (q_of,) = (joint.q for joint in robot.joints if joint.v == v)
    ends = max(low[v], -_WIDE), min(high[v], _WIDE)

    dependent = [joint for joint in robot.joints if joint.name in couplings.dependent]

    def kept(z: Array) -> Bools:
        q = np.repeat(robot.neutral()[:, None], len(z), axis=1)
        q[q_of] = z
        moving = np.zeros((robot.model.nv, len(z)))
        moving[v] = 1.0
        couplings.expand(q, moving, np.zeros(moving.shape))
        inside: Bools = np.ones(len(z), dtype=np.bool_)
        for joint in dependent:
            if moving[joint.v].any():
                inside &= q[joint.q] >= joint.lower - _SLACK
                inside &= q[joint.q] <= joint.upper + _SLACK
        return inside

    z = np.linspace(*ends, _SAMPLES)
    inside = kept(z)
    if inside.all() or not inside.any():
        return float(low[v]), float(high[v])
    middle = int(np.argmin(np.where(inside, np.abs(z), np.inf)))
    left, right = np.flatnonzero(~inside[:middle]), np.flatnonzero(~inside[middle:])
    lower, upper = float(low[v]), float(high[v])
    if len(left):
        lower = _edge(kept, z[left[-1] + 1], z[left[-1]])
    if len(right):
        upper = _edge(kept, z[middle + right[0] - 1], z[middle + right[0]])
    return lower, upper


def _edge(kept: Callable[[Array], Bools], inside: float, outside: float) -> float:
    """Where limits are reached between two positions, by bisection."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        if kept(np.array([middle]))[0]:
            inside = middle
        else:
            outside = middle
    return inside
