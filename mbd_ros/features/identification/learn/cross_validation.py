"""How much of a prediction is trusted: measured on blocks of time that were left out.

Each member of an ensemble leaves a block of time out. What members say of their blocks, put
together, is a prediction of all samples that none of them was fitted to. A joint gets the share of
its torque that explains most there, and none where that does not explain something in nearly all
blocks (one-sided t test, 1 %, since there are several joints).

Source: D. Wolpert, Neural Networks 5, 1992, 241 (predictions of left-out parts as a measure).
"""

from typing import Any

import numpy as np

from mbd_ros.core.state import Array

_LEAST_GAIN = 0.1  # of the square of what is left: a smaller gain is not worth a network
_STUDENT = {2: 31.8, 3: 6.96, 4: 4.54, 5: 3.75}  # one-sided 1 % points, by number of blocks
_NORMAL = 3.4  # of more blocks


def trusted(unseen: Array, wanted: Array, blocks: int, together: bool) -> Array:
    """Share of the torque of each joint that is to be given, 0 .. 1, shape (m,).

    Args:
        unseen: Predictions of samples that were left out, shape (n, m).
        wanted: What they should be, same shape.
        blocks: Pieces of time that were left out, one after another.
        together: One share for all joints.
    """
    u, y, block = unseen, wanted, blocks_of(len(unseen), blocks)

    def sums(values: Array) -> Array:
        of = np.array([values[block == i].sum(axis=0) for i in range(blocks)])
        return np.repeat(of.sum(axis=1)[:, None], u.shape[1], axis=1) if together else of

    share = np.clip(sums(u * y).sum(axis=0) / np.maximum(sums(u * u).sum(axis=0), 1e-300), 0, 1)
    explains = _surely_less(sums(np.square(y - share * u)), sums(np.square(y)))
    return np.asarray(np.where(explains, share, 0.0))


def blocks_of(count: int, members: int) -> Array:
    """Which member leaves each sample out: pieces of time, shape (n,)."""
    return np.asarray(np.minimum(np.arange(count) * members // max(count, 1), members - 1))


def _surely_less(after: Array, before: Array) -> Any:
    """The same of each column of blocks, shape (blocks, ..)."""
    gain = 1.0 - after / np.maximum(before, 1.0e-300)
    error = gain.std(axis=0, ddof=1) / np.sqrt(len(gain))
    is_sure = gain.mean(axis=0) > _STUDENT.get(len(gain), _NORMAL) * error
    return is_sure & (after.sum(axis=0) < (1.0 - _LEAST_GAIN) * before.sum(axis=0))


def is_better(squares: Array, best: Array) -> bool:
    """Whether errors of blocks are surely smaller than others, and by what is worth it.

    Args:
        squares: Sum of the squares of each block, shape (blocks,).
        best: The same of another way.
    """
    return bool(_surely_less(squares, best))
