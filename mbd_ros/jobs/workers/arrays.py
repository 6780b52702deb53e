"""Arrays as JSON holds them, to the bit: what goes to workers and comes back."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array


def pack(values: Array) -> list[Any]:
    """An array of numbers as its shape and a text."""
    data = np.ascontiguousarray(values, dtype="<f8").tobytes()
    return [list(values.shape), base64.b64encode(data).decode()]


def unpack(packed: Sequence[Any]) -> Array:
    """The array that `pack` was given."""
    shape, data = packed
    return np.frombuffer(base64.b64decode(data), dtype="<f8").reshape(shape).copy()
