"""Pairs of near points, by a k-d tree."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mbd_ros.core.state import Array


def near_pairs(x: Array, box: Array | None, reach: float) -> NDArray[np.int32]:
    """Pairs i < j of points whose nearest images are nearer than a distance, in their order.

    Args:
        x: Positions, shape (n, 3).
        box: Edges of the periodic box, shape (3,); None without one.

    Returns:
        Shape (pairs, 2), sorted.
    """
    inside = x
    if box is not None:
        inside = x - box * np.floor(x / box)
        inside[inside >= box] = 0.0  # what rounding leaves on the far side
    pairs = cKDTree(inside, boxsize=box).query_pairs(reach, output_type="ndarray")
    keys = pairs[:, 0] * len(x) + pairs[:, 1]
    keys.sort()
    return np.column_stack(np.divmod(keys, len(x))).astype(np.int32)
