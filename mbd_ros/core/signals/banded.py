"""Symmetric equations with a band, all pieces of them at once.

scipy does the same, but loading it takes longer than a recording of 100 000 samples. Blocks as
wide as the band are coupled each with the next alone: every other one is eliminated, then every
other one of those that are left. An entry of all blocks stands in one row of numbers, so that
blocks of five are eliminated side by side, not by calls of their own.

Source: R. W. Hockney, J. ACM 12, 1965, 95 (odd-even reduction).
"""

import numpy as np

from mbd_ros.core.state import Array

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
        diagonal, beside = np.zeros((2, k, k, count))
        for i in range(k):
            for d in range(k + 1):
                j = i + d
                if j < k:
                    diagonal[i, j] = diagonal[j, i] = rows[d, i::k]
                else:
                    beside[i, j - k] = rows[d, i::k]
        self._shape = count, k
        self._blocks = _blocks(diagonal, beside[..., :-1])

    def solve(self, known: Array) -> Array:
        """Solution for b of shape (n, m), same shape."""
        (count, k), m = self._shape, known.shape[1]
        padded = np.zeros((m, count * k))
        padded[:, : self._n] = known.T
        by_place = np.ascontiguousarray(padded.reshape(m, count, k).transpose(2, 0, 1))
        found = self._blocks.solve(by_place)
        return found.transpose(2, 0, 1).reshape(count * k, m)[: self._n]


def _blocks(diagonal: Array, beside: Array) -> "_Halved | _Dense":
    """Symmetric equations in blocks, each coupled with the next alone.

    Args:
        diagonal: Blocks of the diagonal, shape (k, k, n).
        beside: Blocks that couple each with the next, shape (k, k, n - 1).
    """
    return (_Dense if diagonal.shape[2] <= _FEW else _Halved)(diagonal, beside)


class _Halved:
    """Every other block stays for the next round."""

    def __init__(self, diagonal: Array, beside: Array) -> None:
        k, _, n = diagonal.shape
        self._last = n % 2 == 0  # whether no block follows the last that is eliminated
        before = np.ascontiguousarray(beside[..., ::2])  # rows of those that stay
        after = np.zeros((k, k, n // 2))
        after[..., : (n - 1) // 2] = beside[..., 1::2]
        self._before, self._after = before, after
        self._inverse = _inverse(diagonal[..., 1::2])
        self._from_before = _product("ikn,jkn->ijn", self._inverse, before)
        self._from_after = _product("ikn,kjn->ijn", self._inverse, after)
        left = diagonal[..., ::2].copy()
        left[..., : n // 2] -= _product("ikn,kjn->ijn", before, self._from_before)
        pushed = _product("kin,kjn->ijn", after, self._from_after)
        left[..., 1:] -= pushed[..., : left.shape[2] - 1]
        coupled = -_product("ikn,kjn->ijn", before, self._from_after)
        self._left = _blocks(left, coupled[..., : left.shape[2] - 1])

    def solve(self, known: Array) -> Array:
        """Solution for blocks of shape (k, m, n)."""
        half = known.shape[2] // 2
        inside = _product("ikn,kmn->imn", self._inverse, known[..., 1::2])
        right = known[..., ::2].copy()
        right[..., :half] -= _product("ikn,kmn->imn", self._before, inside)
        pushed = _product("kin,kmn->imn", self._after, inside)
        right[..., 1:] -= pushed[..., : right.shape[2] - 1]
        stayed = self._left.solve(right)
        inside -= _product("ikn,kmn->imn", self._from_before, stayed[..., :half])
        following = half - self._last
        after = self._from_after[..., :following]
        inside[..., :following] -= _product("ikn,kmn->imn", after, stayed[..., 1:])
        found = np.empty(known.shape)
        found[..., ::2], found[..., 1::2] = stayed, inside
        return found


class _Dense:
    """All at once."""

    def __init__(self, diagonal: Array, beside: Array) -> None:
        k, _, n = diagonal.shape
        whole = np.zeros((n, k, n, k))
        for i in range(n):
            whole[i, :, i] = diagonal[..., i]
        for i in range(n - 1):
            whole[i, :, i + 1], whole[i + 1, :, i] = beside[..., i], beside[..., i].T
        self._whole = whole.reshape(n * k, n * k)
        np.linalg.cholesky(self._whole)  # raises

    def solve(self, known: Array) -> Array:
        """See `_Halved`."""
        k, m, n = known.shape
        solved = np.linalg.solve(self._whole, known.transpose(2, 0, 1).reshape(n * k, m))
        return np.ascontiguousarray(solved.reshape(n, k, m).transpose(1, 2, 0))


def _product(places: str, left: Array, right: Array) -> Array:
    """Products of blocks."""
    found: Array = np.einsum(places, left, right)
    return found


def _inverse(blocks: Array) -> Array:
    """Inverses of symmetric blocks, shape (k, k, n), by sweeps.

    Source: J. H. Goodnight, Am. Stat. 33, 1979, 149.
    """
    swept = np.ascontiguousarray(blocks)
    for p in range(len(swept)):
        pivot = swept[p, p]
        if not (pivot > 0.0).all():
            raise np.linalg.LinAlgError("not positive definite")
        row, column = swept[p] / pivot, swept[:, p].copy()
        row[p] = 1.0 / pivot
        column[p] = 0.0
        swept[:, p] = 0.0
        swept -= column[:, None] * row
        swept[p] = row
    return swept
