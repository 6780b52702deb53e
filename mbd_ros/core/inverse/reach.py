"""Reach of actuators, and names in messages."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY

_NAMED = 0.3  # share of a joint in a direction, of the largest, to be named
_SHOWN = 4  # joints in a message
_DIGITS = 9  # of shares that differ; beyond them is rounding
_LISTED = 12  # names in a message


class Reach(NamedTuple):
    """The reach of the actuators at a state.

    Attributes:
        freedom: Motions that the rows allow.
        driven: How many of them the efforts reach.
        undriven: Joints that move in the others.
        null_space: As in `Torques`.
        undetermined: As in `Torques`.
    """

    freedom: int
    driven: int
    undriven: tuple[str, ...]
    null_space: int
    undetermined: tuple[str, ...]


def listed(names: Sequence[str]) -> str:
    """Names for a message, the first ones of many."""
    rest = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {rest} more" if rest > 0 else "")


def movers(robot: Robot, directions: Array, M: Array) -> tuple[str, ...]:
    """Joints that carry most of some motions by kinetic energy, equal ones in the robot's order.

    Args:
        robot: The robot.
        directions: Motions, one a column, shape (nv, k).
        M: Mass matrix, shape (nv, nv).
    """
    names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
    share: Any = np.sqrt(M.diagonal()) * np.linalg.norm(directions, axis=1)
    share = np.round(share / max(share.max(), TINY), _DIGITS)
    order = np.argsort(-share, kind="stable")
    chosen = [int(i) for i in order if share[i] > _NAMED * share.max() > 0.0]
    return tuple(dict.fromkeys(names[i] for i in chosen))[:_SHOWN]
