"""Which rows are not combinations of those before them."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant


def independent(J: Array) -> list[int]:
    """Numbers of the rows of a matrix that are not combinations of rows before them."""
    kept, basis = list[int](), np.zeros((0, J.shape[1]))
    for number, direction in enumerate(J):
        left = direction - basis.T.dot(basis.dot(direction))
        left = left - basis.T.dot(basis.dot(left))
        size = float(np.linalg.norm(left))
        if size**2 > redundant(len(J)) * float(direction.dot(direction)):
            kept.append(number)
            basis = np.vstack((basis, left / size))
    return kept
