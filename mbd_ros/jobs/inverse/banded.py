"""Symmetric equations with a band, all pieces of them at once.

scipy does the same, but loading it takes longer than a recording of 100 000 samples.
"""

import numpy as np

from mbd_ros.core.state import Array

_GROUP = 4  # blocks, the last of which stays for the next round
_FEW = 12  # blocks that are solved at once


class Banded:
    """A x = b, A symmetric and positive definite, prepared for several b.

    Args:
        band: A in upper banded form: row k - d has the diagonal d above the main one, from column
            d on; shape (k + 1, n).

    Raises:
        numpy.linalg.LinAlgError: A is not positive definite.
    """

    def __init__(self, band: Array) -> None:
        k, self._n = len(band) - 1, band.shape[1]
        count = -(-self._n // k)
        rows = np.zeros((k + 1, count * k))
        rows[0, self._n :] = 1.0
        for d in range(k + 1):
            rows[d, : max(self._n - d, 0)] = band[k - d, d:]
        diagonal, beside = np.zeros((2, count, k, k))
        for i in range(k):
            for d in range(k + 1):
                j = i + d
                if j < k:
                    diagonal[:, i, j] = diagonal[:, j, i] = rows[d, i::k]
                else:
                    beside[:, i, j - k] = rows[d, i::k]
        self._blocks = _blocks(diagonal, beside[:-1])

    def solve(self, known: Array) -> Array:
        """Solution for b of shape (n, m), same shape."""
        count, k = self._blocks.shape
        padded = np.zeros((count * k, known.shape[1]))
        padded[: self._n] = known
        return self._blocks.solve(padded.reshape(count, k, -1)).reshape(count * k, -1)[: self._n]


def _blocks(diagonal: Array, beside: Array) -> "_Groups | _Dense":
    """Symmetric equations in blocks, each coupled with the next alone.

    Args:
        diagonal: Blocks of the diagonal, shape (n, k, k).
        beside: Blocks that couple each with the next, shape (n - 1, k, k).
    """
    return (_Dense if len(diagonal) <= _FEW else _Groups)(diagonal, beside)


class _Groups:
    """Of each group the last block stays; what is eliminated between them is alike in size."""

    def __init__(self, diagonal: Array, beside: Array) -> None:
        n, k, _ = diagonal.shape
        self.shape = n, k
        count = -(-n // _GROUP)
        lacking = count * _GROUP - n
        identities = np.broadcast_to(np.eye(k), (lacking, k, k))
        D = np.concatenate([diagonal, identities]).reshape(count, _GROUP, k, k)
        E = np.concatenate([beside, np.zeros((lacking + 1, k, k))]).reshape(D.shape)
        width = (_GROUP - 1) * k
        inside = np.zeros((count, _GROUP - 1, k, _GROUP - 1, k))
        for i in range(_GROUP - 1):
            inside[:, i, :, i] = D[:, i]
        for i in range(_GROUP - 2):
            inside[:, i, :, i + 1], inside[:, i + 1, :, i] = E[:, i], E[:, i].mT
        inside = inside.reshape(count, width, width)
        np.linalg.cholesky(inside)  # raises
        sides = np.zeros((count, _GROUP - 1, k, 2 * k))  # with the group before, and the last
        sides[1:, 0, :, :k] = E[:-1, -1].mT
        sides[:, -1, :, k:] = E[:, -2]
        self._sides = sides.reshape(count, width, 2 * k)
        self._inverse = np.linalg.inv(inside)
        self._found = self._inverse @ self._sides
        handed = self._sides.mT @ self._found
        left = D[:, -1] - handed[:, k:, k:]
        left[:-1] -= handed[1:, :k, :k]
        self._left = _blocks(left, -handed[1:, :k, k:])

    def solve(self, known: Array) -> Array:
        """Solution for blocks of shape (n, k, m)."""
        (n, k), m, count = self.shape, known.shape[2], len(self._inverse)
        b = np.concatenate([known, np.zeros((count * _GROUP - n, k, m))])
        b = b.reshape(count, _GROUP * k, m)
        inside = self._inverse @ b[:, :-k]
        handed = self._sides.mT @ inside
        right = b[:, -k:] - handed[:, k:]
        right[:-1] -= handed[1:, :k]
        last = self._left.solve(right)
        around = np.zeros((count, 2 * k, m))
        around[1:, :k], around[:, k:] = last[:-1], last
        inside -= self._found @ around
        return np.concatenate([inside, last], axis=1).reshape(-1, k, m)[:n]


class _Dense:
    """All at once."""

    def __init__(self, diagonal: Array, beside: Array) -> None:
        n, k, _ = diagonal.shape
        self.shape = n, k
        whole = np.zeros((n, k, n, k))
        for i in range(n):
            whole[i, :, i] = diagonal[i]
        for i in range(n - 1):
            whole[i, :, i + 1], whole[i + 1, :, i] = beside[i], beside[i].T
        self._whole = whole.reshape(n * k, n * k)
        np.linalg.cholesky(self._whole)  # raises

    def solve(self, known: Array) -> Array:
        """See `_Groups`."""
        solved = np.linalg.solve(self._whole, known.reshape(len(self._whole), -1))
        return solved.reshape(known.shape)
