"""Many small matrices at once, those of one chain after the other along the last axis."""

import numpy as np

from mbd_ros.core.state import Array

_LOOPED = 4  # rows up to which a loop over them costs less than a call a matrix


def solve(A: Array, b: Array) -> Array:
    """A^-1 b by elimination without exchange of rows; not finite where a pivot is 0.

    The matrices here are Gram matrices of rows or near them, for which that is stable.

    Args:
        A: Shape (m, m, n).
        b: Shape (m, n) or (m, k, n).

    Returns:
        Shape as `b`.
    """
    m = len(A)
    if m > _LOOPED:
        try:
            if b.ndim == 2:
                one: Array = np.linalg.solve(A.transpose(2, 0, 1), b.T[:, :, None])[:, :, 0].T
                return one
            many: Array = np.linalg.solve(A.transpose(2, 0, 1), b.transpose(2, 0, 1))
            return many.transpose(1, 2, 0)
        except np.linalg.LinAlgError:  # one of them is singular: the others count
            pass
    A, x = A.copy(), b.copy()
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for i in range(m):
            for j in range(i + 1, m):
                share = A[j, i] / A[i, i]
                A[j, i + 1 :] -= share * A[i, i + 1 :]
                x[j] -= share * x[i]
        for i in reversed(range(m)):
            for j in range(i + 1, m):
                x[i] -= A[i, j] * x[j]
            x[i] /= A[i, i]
    return x


def log_determinant(A: Array) -> Array:
    """Logarithms of determinants of symmetric matrices, shape (n,); -inf where det A <= 0.

    Args:
        A: Shape (m, m, n).
    """
    m = len(A)
    if m > _LOOPED:
        sign, size = np.linalg.slogdet(A.transpose(2, 0, 1))
        return np.where(sign > 0.0, size, -np.inf)
    A, found = A.copy(), np.zeros(A.shape[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(m):
            for j in range(i + 1, m):
                A[j, i + 1 :] -= A[j, i] / A[i, i] * A[i, i + 1 :]
            found += np.log(np.maximum(A[i, i], 0.0))
    return np.where(np.isnan(found), -np.inf, found)


def inverse(A: Array) -> Array:
    """A^-1, shape (m, m, n), of matrices as for `solve`."""
    unit = np.zeros(A.shape)
    unit[np.arange(len(A)), np.arange(len(A))] = 1.0
    return solve(A, unit)
