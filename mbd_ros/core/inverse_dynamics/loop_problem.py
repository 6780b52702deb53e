"""The equation of inverse dynamics at one state, and whether that is a toggle."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbd_ros.core.inverse_dynamics.force_split import ForceSplit
from mbd_ros.core.inverse_dynamics.loop_motion import LoopMotion
from mbd_ros.core.inverse_dynamics.unknowns import Mask
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError

_ASIDE = 0.1  # of a neighbour that tells whether a mechanism is at a toggle [rad or m]


class Problem(NamedTuple):
    """The equation at one state.

    Attributes:
        split: Its factors.
        b: Force on all joints that is to be split, shape (nv,).
        scale: Size of the terms in it, in the metric of the split.
        asked: Which unknowns the split has; the motion shows the others, shape (n,).
        known: What those are: efforts, then multipliers, targets of the cost in place of those
            that are asked for, shape (na + m,).
    """

    split: ForceSplit
    b: Array
    scale: float
    asked: Mask
    known: Array


def is_at_toggle(
    loops: LoopMotion, x: State, split: ForceSplit, beside: Callable[[State], ForceSplit]
) -> bool:
    """Whether neighbours on the constraints have fewer motions.

    Args:
        loops: The mechanism.
        x: State on the constraints.
        split: Factors there.
        beside: Gives the factors at another state on the constraints.
    """
    for motion in split.motions().T:
        q = loops.moved(x.q, _ASIDE / np.abs(motion).max() * motion)
        try:
            there = State(x.t, loops.start(x._replace(q=q)), 0.0 * x.v)
        except SolveError:
            continue
        if beside(there).freedom < split.freedom:
            return True
    return False
