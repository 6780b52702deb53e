"""Reach of actuators, and names in messages."""

from collections.abc import Sequence
from typing import NamedTuple

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
