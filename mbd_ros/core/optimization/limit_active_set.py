"""The exact optimum of `limited_qp` on given acting limits, and whether these are right."""

from typing import NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

Sides = NDArray[np.int8]
_REGULAR = 1.0e-9  # reciprocal condition of the Gram matrix of rows that are independent
_RANK = 1.0e-9  # of a row of length one: what rounding leaves of one that others fix
_NO_EXCESS = 1.0e-10  # of the largest gap
_SLACK = 1.0e-12  # of the largest gap: how far an idle limit may be passed


class Candidate(NamedTuple):
    """What follows from the limits that are said to act.

    Attributes:
        y: The optimum if they are the right ones, shape (n,).
        side: Those that acted without the ones that would pull, with those that y passes; 1 for
            a lower limit, -1 for an upper one, else 0, shape (m,).
        is_softened: Whether soft rows give way.
        is_optimal: Whether no limit changed: y is the optimum.
    """

    y: Array
    side: Sides
    is_softened: bool
    is_optimal: bool


def candidate(
    G: Array, lower: Array, upper: Array, side: Sides, hard: int, size: float
) -> Candidate:
    """The smallest y on the limits that act.

    Args:
        G: Rows of length one, the hard ones first, shape (m, n).
        lower: Shape (m,).
        upper: Same.
        side: Limits that act, shape (m,).
        hard: Number of hard rows.
        size: The largest gap at y = 0.
    """
    bound = np.where(side > 0, lower, upper)
    side = np.where(np.isfinite(bound), side, 0).astype(np.int8)
    acting = side.nonzero()[0]
    rows, signs, bound = G[acting], side[acting], bound[acting]
    found = _on_independent(rows, bound)
    is_softened = False
    if found is None:
        first = int(np.searchsorted(acting, hard))
        y, force, is_softened = _on_dependent(rows, bound, first, size)
    else:
        y, force = found
    after, reached, slack = side.copy(), G.dot(y), _SLACK * size
    pulls = (force * signs < 0.0) & (lower[acting] < upper[acting])
    after[acting[pulls]] = 0
    idle = side == 0
    after[idle & (reached < lower - slack)] = 1
    after[idle & (reached > upper + slack)] = -1
    is_optimal = bool((after == side).all() and np.isfinite(y).all())
    return Candidate(y, after, is_softened, is_optimal)


def _on_independent(rows: Array, bound: Array) -> tuple[Array, Array] | None:
    """The smallest y with rows y = bound and its multipliers; None where rows depend on others."""
    count, n = rows.shape
    if count == 0:
        return np.zeros(n), np.zeros(0)
    if count > n:
        return None
    gram = eigenpy.LLT(rows.dot(rows.T))
    if gram.info().name != "Success" or not gram.rcond() > _REGULAR:
        return None
    force = gram.solve(bound).reshape(-1)
    return force.dot(rows), force


def _on_dependent(rows: Array, bound: Array, hard: int, size: float) -> tuple[Array, Array, bool]:
    """Y with the hard rows kept, then the least |soft rows y - bound|, then the least |y|.

    The second result is a number of the sign of the multiplier of each row. Those of the least
    excess decide, and where they leave a row idle, those of the least |y|; the third result is
    whether there is an excess.
    """
    H, S = rows[:hard], rows[hard:]
    onto_hard = _inverse(H)
    y = onto_hard.dot(bound[:hard])
    y = y + _inverse(S - S.dot(onto_hard).dot(H)).dot(bound[hard:] - S.dot(y))
    excess = bound[hard:] - S.dot(y)
    excess = np.where(np.abs(excess) > _NO_EXCESS * size, excess, 0.0)
    held = -onto_hard.T.dot(excess.dot(S))
    force = np.concatenate([held, excess])
    force = np.where(np.abs(force) > _NO_EXCESS * size, force, 0.0)
    idle = force == 0.0
    if idle.any():
        fixed, others = rows[~idle], rows[idle]
        onto_fixed = _inverse(fixed)
        others = others - others.dot(onto_fixed).dot(fixed)
        least = _inverse(others).T.dot(y - onto_fixed.dot(fixed.dot(y)))
        force[idle] = np.where(np.abs(least) > _SLACK * size, least, 0.0)
    return y, force, bool(excess.any())


def _inverse(A: Array) -> Array:
    """The pseudo-inverse; what is shorter than `_RANK` counts as nothing."""
    length = float(np.sqrt((A * A).sum(axis=0).max(initial=0.0)))
    if not length > _RANK:
        return np.zeros(A.shape[::-1])
    factor = eigenpy.CompleteOrthogonalDecomposition(*A.shape)
    factor.setThreshold(_RANK / length)
    factor.compute(A)
    return factor.pseudoInverse().reshape(A.shape[::-1])  # eigenpy flattens one column
