"""The exact optimum of `hard_soft_qp` on given acting limits, and whether these are right.

Equality-constrained least norm by ranks: the hard rows first, then the least excess of the soft
rows, then the smallest y. Source: A. Escande, N. Mansard, P. Wieber, Int. J. Robotics Research
33(7) (2014).
"""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.optimization.active_set import Sides, on_independent, passed, pseudo_inverse
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CLOSED_GAP

_NO_EXCESS = 1.0e-10  # of the largest gap


class Candidate(NamedTuple):
    """What follows from the limits that are said to act.

    Attributes:
        y: The optimum if they are the right ones, shape (n,).
        side: Limits to try next: those that would pull have left, those that y passes have
            joined; 1 for a lower limit, -1 for an upper one, else 0, shape (m,).
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
    found = on_independent(rows, bound)
    is_softened = False
    if found is None:
        first = int(np.searchsorted(acting, hard))
        y, force, is_softened = _on_dependent(rows, bound, first, size)
    else:
        y, force = found
    after, reached, slack = side.copy(), G.dot(y), CLOSED_GAP * size
    pulls = (force * signs < 0.0) & (lower[acting] < upper[acting])
    after[acting[pulls]] = 0
    idle = side == 0
    after[idle] = passed(reached, lower, upper, slack)[idle]
    is_optimal = bool((after == side).all() and np.isfinite(y).all())
    return Candidate(y, after, is_softened, is_optimal)


def _on_dependent(rows: Array, bound: Array, hard: int, size: float) -> tuple[Array, Array, bool]:
    """The smallest y of those with the least |soft rows y - bound| of those on the hard rows.

    The second result has the sign of the multiplier of each row. The multipliers of the least
    excess decide it; where they leave a row idle, those of the least |y| do. The third result
    says whether there is an excess.
    """
    H, S = rows[:hard], rows[hard:]
    onto_hard = pseudo_inverse(H)
    y = onto_hard.dot(bound[:hard])
    y = y + pseudo_inverse(S - S.dot(onto_hard).dot(H)).dot(bound[hard:] - S.dot(y))
    excess = bound[hard:] - S.dot(y)
    excess = np.where(np.abs(excess) > _NO_EXCESS * size, excess, 0.0)
    held = -onto_hard.T.dot(excess.dot(S))
    force = np.concatenate([held, excess])
    force = np.where(np.abs(force) > _NO_EXCESS * size, force, 0.0)
    idle = force == 0.0
    if idle.any():
        fixed, others = rows[~idle], rows[idle]
        onto_fixed = pseudo_inverse(fixed)
        others = others - others.dot(onto_fixed).dot(fixed)
        least = pseudo_inverse(others).T.dot(y - onto_fixed.dot(fixed.dot(y)))
        force[idle] = np.where(np.abs(least) > CLOSED_GAP * size, least, 0.0)
    return y, force, bool(excess.any())
