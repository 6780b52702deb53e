"""The guard that all numbers pass before they leave a node: every writer of messages asks it."""

import math

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError


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
