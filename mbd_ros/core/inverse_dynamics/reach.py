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


def unreachable(
    labels: Sequence[str], joints: Sequence[str], share: float, at_toggle: bool
) -> str:
    """Message for a motion that efforts cannot produce.

    Args:
        labels: `<effort>.effort` of all.
        joints: Those that move in what is left.
        share: Of the forces at work that is left.
        at_toggle: Whether the mechanism is at a toggle.
    """
    by = ", ".join(label.rpartition(".")[0] for label in labels) or "none"
    toggle = "; the mechanism is at a toggle" if at_toggle else ""
    return (
        f"the actuators ({by}) cannot produce this motion: {share:.2g} of the forces at work are "
        f"without an actuator, along {', '.join(joints)}; these need an actuator, or the motion "
        f"better derivatives{toggle}"
    )


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
