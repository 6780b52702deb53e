"""Messages that are dropped or not sent, and why.

Writers of messages ask `require_finite` before numbers leave a node.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_MOST, _LONGEST = 8, 64  # names, letters


class MessageError(ValueError):
    """A message that must be dropped: says which field is wrong and why."""


def is_surely_finite(values: NDArray[np.float64]) -> bool:
    """Whether no value is NaN or infinite, in one product; False where squares overflow too."""
    return math.isfinite(np.vdot(values, values))  # which never warns of that


def require_finite(**fields: NDArray[np.float64]) -> None:
    """Refuse to send what is not finite.

    Args:
        **fields: Vectors, by the name under which they would be sent.

    Raises:
        MessageError: Names the field and the places in it.
    """
    for field, values in fields.items():
        if is_surely_finite(values):
            continue
        lost = np.flatnonzero(~np.isfinite(values)).tolist()
        if lost:
            places = ", ".join(map(str, lost[:4])) + (", .." if len(lost) > 4 else "")
            raise MessageError(f"{field} is not finite at index {places} and is not sent")


def listed(names: Sequence[str]) -> str:
    """Names of a message for people: the first ones, shortened, whatever was sent."""
    shown = ", ".join(_printable(name) for name in names[:_MOST])
    return shown if len(names) <= _MOST else f"{shown} and {len(names) - _MOST} more"


def _printable(name: str) -> str:
    start = "".join(letter if letter.isprintable() else "?" for letter in name[:_LONGEST])
    return start if len(name) <= _LONGEST else f"{start} ({len(name)} letters)"
