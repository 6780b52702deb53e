"""Arrays where vectors of the processor may stand."""

import numpy as np

from mbd_ros.core.state import Array

_ALIGNED = 64  # bytes, of the widest vectors


def aligned(size: int, lanes: int = 1) -> Array:
    """Zeros, shape (size,), or (size, lanes) where each is a vector of several numbers."""
    room = np.zeros(size * lanes + _ALIGNED // 8)
    first = -room.ctypes.data % _ALIGNED // 8
    values = room[first : first + size * lanes]
    return values if lanes == 1 else values.reshape(size, lanes)
