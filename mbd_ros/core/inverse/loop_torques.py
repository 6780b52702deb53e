"""Results of inverse dynamics of mechanisms with loops."""

from collections.abc import Sequence
from typing import NamedTuple

from mbd_ros.core.state import Array

_LISTED = 12  # names in a message


class LoopTorques(NamedTuple):
    """Efforts and multipliers that move a mechanism with loops.

    Attributes:
        tau: Effort of every actuated joint [N·m or N], shape (na,).
        multipliers: One a row of `ClosedLoopInverseDynamics.constraints`, shape (m,); that of a
            drive is its effort.
        null_space: Dimension of the efforts and multipliers that together exert nothing.
        undetermined: `<joint>.effort` and `<row>.multiplier` that take part in it.
        condition: Beyond 1e6 the mechanism is near a toggle and the result unreliable.
    """

    tau: Array
    multipliers: Array
    null_space: int
    undetermined: tuple[str, ...]
    condition: float


class Reach(NamedTuple):
    """The reach of the actuators at a state.

    Attributes:
        freedom: Motions that the rows allow.
        driven: How many of them the efforts reach.
        undriven: Joints that move in the others.
        null_space: As in `LoopTorques`.
        undetermined: As in `LoopTorques`.
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
