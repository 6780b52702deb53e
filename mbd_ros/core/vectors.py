"""Products of many vectors at once."""

import numpy as np

from mbd_ros.core.state import Array


def cross(a: Array, b: Array) -> Array:
    """Products a x b of vectors in the last axis, broadcast; np.cross takes several times as long.

    Args:
        a: Shape (.., 3).
        b: Shape (.., 3).
    """
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out
