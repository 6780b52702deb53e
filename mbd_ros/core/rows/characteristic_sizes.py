"""How large masses and rows usually are, so that one which vanishes shows."""

from collections.abc import Callable
from typing import Any, NamedTuple

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

_PROBES = 9


class UsualSizes(NamedTuple):
    """Medians over configurations all over the range of the joints, closed or not.

    At a toggle a row may vanish altogether: scaled by itself, rounding would look like a
    direction. What a row usually is does not depend on where a motion has been.

    Attributes:
        inertia: Diagonal of M [kg·m^2 or kg], shape (nv,).
        mobility: Diagonal of J M^-1 J', shape (m,).
        square: Diagonal of J J', shape (m,).
        weights: Row i times entry i gives rows of length one where M is its diagonal, (m, nv).
    """

    inertia: Array
    mobility: Array
    square: Array
    weights: Array


def usual_norms(robot: Robot, at: Callable[[Array], tuple[Array, Array]]) -> Array:
    """Norms of columns in the metric M^-1, shape (k,).

    Args:
        robot: The robot.
        at: Configuration -> M, shape (nv, nv), and the columns, shape (nv, k).
    """
    found = []
    with np.errstate(all="ignore"):
        for q in configurations(robot):
            M, columns = at(q)
            found.append(np.sqrt(_squares(M, columns)))
    return _median(found)


def usual_sizes(robot: Robot, at: Callable[[Array], tuple[Array, Array]]) -> UsualSizes:
    """Sizes of rows; 0 where nothing is finite.

    Args:
        robot: The robot.
        at: Configuration -> M, shape (nv, nv), and the rows, shape (m, nv).
    """
    found = []
    with np.errstate(all="ignore"):
        for q in configurations(robot):
            M, J = at(q)
            found.append((M.diagonal().copy(), _squares(M, J.T), J * J))
    inertia, mobility, square = (_median(each) for each in zip(*found, strict=True))
    share = 1.0 / np.where(inertia > 0.0, inertia, 1.0)
    length = square.dot(share)
    weights = np.sqrt(share / np.where(length > 0.0, length, 1.0)[:, None])
    return UsualSizes(inertia, mobility, square.sum(axis=1), weights)


def configurations(robot: Robot) -> list[Array]:
    """Configurations over the range of all joints, a turn or a metre where it has no ends."""
    turns = np.sin(np.outer(np.arange(1, _PROBES + 1), np.arange(1.0, robot.model.nv + 1)))
    middle, half = np.zeros(robot.model.nv), np.ones(robot.model.nv)
    for joint in robot.joints:
        half[joint.v] = most = 1.0 if joint.kind == "prismatic" else np.pi
        if joint.upper - joint.lower < np.inf:
            middle[joint.v] = 0.5 * (joint.lower + joint.upper)
            half[joint.v] = min(0.5 * (joint.upper - joint.lower), most)
    neutral = robot.neutral()
    return [pin.integrate(robot.model, neutral, middle + half * turn) for turn in turns]


def _squares(M: Array, columns: Array) -> Array:
    """The c' M^-1 c of every column, shape (k,)."""
    X = eigenpy.LLT(M).solve(columns).reshape(columns.shape)  # eigenpy flattens one column
    return np.asarray(np.einsum("ij,ij->j", columns, X), dtype=np.float64)


def _median(values: Any) -> Array:
    """The median of those that are finite; half of them are enough."""
    stacked = np.array(values)
    kept = np.where(np.isfinite(stacked), stacked, 0.0)
    return np.asarray(np.median(kept, axis=0), dtype=np.float64)
