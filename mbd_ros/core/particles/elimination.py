"""Many small systems of linear equations, solved side by side."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant

_LONGEST = 6  # rows up to which a loop over them costs less than a library call a system


def solved(A: Array, b: Array) -> Array:
    """The x with A x = b in every lane; A is regular and nearly symmetric and definite.

    Args:
        A: Shape (m, m, lanes).
        b: Shape (m, lanes).
    """
    m = len(b)
    if m == 1:
        one: Array = b / A[0]
        return one
    if m > _LONGEST:
        many: Array = np.linalg.solve(A.transpose(2, 0, 1), b.T[:, :, None])[:, :, 0].T
        return many
    rows, right = [[A[i, j] for j in range(m)] for i in range(m)], [b[i] for i in range(m)]
    for k in range(m):
        inverse = 1.0 / rows[k][k]
        for i in range(k + 1, m):
            factor = rows[i][k] * inverse
            right[i] = right[i] - factor * right[k]
            for j in range(k + 1, m):
                rows[i][j] = rows[i][j] - factor * rows[k][j]
        rows[k][k] = inverse
    for k in reversed(range(m)):
        for j in range(k + 1, m):
            right[k] = right[k] - rows[k][j] * right[j]
        right[k] = right[k] * rows[k][k]
    return np.array(right)


def least_solved(A: Array, b: Array) -> Array:
    """The x of smallest norm with A x nearest to b in every lane, where rows are redundant."""
    inverse = np.linalg.pinv(A.transpose(2, 0, 1), rcond=redundant(len(b)))
    least: Array = np.matmul(inverse, b.T[:, :, None])[:, :, 0].T
    return least
