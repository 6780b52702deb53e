"""The nearest state and its metric, common to both methods."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.move_qp import Metric, row_weight
from mbd_ros.core.state import Array

_SHARE = 0.1  # of a free direction from which a joint counts as free


class Nearest(NamedTuple):
    """The nearest state, checked.

    Attributes:
        q: Configuration, shape (n,).
        v: Velocity, shape (n,).
        lam: Multipliers of the rows that kept q, shape (m,).
        mu: Multipliers of the limits that kept q, shape (n,).
        iterations: Steps to q.
        condition: Condition number of the rows in the metric; 1 where none had to be factorised.
    """

    q: Array
    v: Array
    lam: Array
    mu: Array
    iterations: int
    condition: float


def metric_of(
    M: Array, J: Array, known: NDArray[np.bool_], amplification: float
) -> tuple[Metric, NDArray[np.bool_]]:
    """Mass metric of the measured joints.

    A joint that was not measured costs nothing to move, so that the rows alone place it. Some
    joints the rows leave free, or would place with errors larger than those of the measured
    joints by more than `amplification`. They keep their mass: they stay, as far as the rows let
    them.

    Args:
        M: Mass matrix, shape (n, n).
        J: Rows, shape (m, n).
        known: Measured joints, shape (n,).
        amplification: See above; in raw units, rad and m alike.

    Returns:
        The metric, and the joints without measurement that the rows leave free, shape (n,).
    """
    undetermined = np.zeros(len(M), dtype=np.bool_)
    if known.all():
        return Metric(M, None), undetermined
    free = (~known).nonzero()[0]
    W = np.where(known[:, None] & known, M, 0.0)
    length = np.sqrt((J * J).sum(axis=1))
    reach = J[:, free] / np.where(length > 0.0, length, 1.0)[:, None]
    _, sizes, directions = np.linalg.svd(reach)
    rank = int(np.count_nonzero(sizes * amplification > 1.0))
    null = directions[rank:].T
    block = np.ix_(free, free)
    W[block] = null.dot(null.T.dot(M[block]).dot(null)).dot(null.T)
    undetermined[free] = (np.abs(null) > _SHARE).any(axis=1)
    return Metric(W, row_weight(M, J)), undetermined
