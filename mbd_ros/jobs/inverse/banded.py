"""Symmetric equations with a band, all pieces of them at once.

scipy does the same, but loading it takes longer than a recording of 100 000 samples.
"""

import numpy as np

from mbd_ros.core.state import Array

_GROUP = 4  # blocks, the last of which stays for the next round
_FEW = 12  # blocks that are solved at once


def solve_banded(band: Array, known: Array) -> Array:
    """Solution x of A x = b, A symmetric and positive definite.

    Args:
        band: A in upper banded form: row k - d has the diagonal d above the main one, from column
            d on; shape (k + 1, n).
        known: b, shape (n, m).

    Returns:
        Shape (n, m).

    Raises:
        numpy.linalg.LinAlgError: A is not positive definite.
    """
    k, n = len(band) - 1, band.shape[1]
    count = -(-n // k)
    rows = np.zeros((k + 1, count * k + k))
    rows[0, n:] = 1.0
    for d in range(k + 1):
        rows[d, : max(n - d, 0)] = band[k - d, d:]
    diagonal, beside = np.zeros((2, count, k, k))
    for i in range(k):
        for d in range(k + 1):
            of_block, j = rows[d, i : count * k : k], i + d
            if j < k:
                diagonal[:, i, j] = diagonal[:, j, i] = of_block
            else:
                beside[:, i, j - k] = of_block
    padded = np.zeros((count * k, known.shape[1]))
    padded[:n] = known
    solved = _solved(diagonal, beside[:-1], padded.reshape(count, k, -1))
    return solved.reshape(count * k, -1)[:n]


def _solved(diagonal: Array, beside: Array, known: Array) -> Array:
    """Solution of symmetric equations in blocks, each coupled with the next alone.

    Of each group the last block stays; what is eliminated between them is all alike in size.

    Args:
        diagonal: Blocks of the diagonal, shape (n, k, k).
        beside: Blocks that couple each with the next, shape (n - 1, k, k).
        known: Shape (n, k, m).
    """
    n, k, m = known.shape
    if n <= _FEW:
        return _dense(diagonal, beside, known)
    count = -(-n // _GROUP)
    lacking = count * _GROUP - n
    diagonal = np.concatenate([diagonal, np.broadcast_to(np.eye(k), (lacking, k, k))])
    beside = np.concatenate([beside, np.zeros((lacking + 1, k, k))])
    known = np.concatenate([known, np.zeros((lacking, k, m))])
    D, E, b = (a.reshape(count, _GROUP, k, -1) for a in (diagonal, beside, known))
    inside, width = np.zeros((count, _GROUP - 1, k, _GROUP - 1, k)), (_GROUP - 1) * k
    for i in range(_GROUP - 1):
        inside[:, i, :, i] = D[:, i]
    for i in range(_GROUP - 2):
        inside[:, i, :, i + 1], inside[:, i + 1, :, i] = E[:, i], E[:, i].mT
    couplings = np.zeros((count, _GROUP - 1, k, 2 * k))  # with the group before, and the last
    couplings[1:, 0, :, :k] = E[:-1, -1].mT
    couplings[:, -1, :, k:] = E[:, -2]
    couplings = couplings.reshape(count, width, 2 * k)
    sides = np.concatenate([couplings, b[:, :-1].reshape(count, width, m)], axis=2)
    inside = inside.reshape(count, width, width)
    np.linalg.cholesky(inside)  # raises
    found = np.linalg.solve(inside, sides)
    handed = couplings.mT @ found
    left, right = D[:, -1] - handed[:, k:, k : 2 * k], b[:, -1] - handed[:, k:, 2 * k :]
    left[:-1] -= handed[1:, :k, :k]
    right[:-1] -= handed[1:, :k, 2 * k :]
    last = _solved(left, -handed[1:, :k, k : 2 * k], right)
    around = np.concatenate([np.concatenate([np.zeros_like(last[:1]), last[:-1]]), last], axis=1)
    within = (found[:, :, 2 * k :] - found[:, :, : 2 * k] @ around).reshape(count, -1, k, m)
    return np.concatenate([within, last[:, None]], axis=1).reshape(-1, k, m)[:n]


def _dense(diagonal: Array, beside: Array, known: Array) -> Array:
    n, k, m = known.shape
    whole = np.zeros((n, k, n, k))
    for i in range(n):
        whole[i, :, i] = diagonal[i]
    for i in range(n - 1):
        whole[i, :, i + 1], whole[i + 1, :, i] = beside[i], beside[i].T
    matrix = whole.reshape(n * k, n * k)
    np.linalg.cholesky(matrix)  # raises
    return np.linalg.solve(matrix, known.reshape(n * k, m)).reshape(n, k, m)
