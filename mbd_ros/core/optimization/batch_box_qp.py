"""Many small quadratic programs at once: moves in boxes, with rows that are kept.

    min 1/2 p' H p + g' p   subject to   low <= p <= high,   A p = b

There is one problem a frame. Bounds are exchanged all at once, as a primal-dual active set does.
Where that does not settle, the last move is cut to the box: the caller judges a move by what it
gains. Source: M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13 (2002).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

_EXCHANGES = 12
_SOFT = 1.0e-13  # of the largest entry: what keeps dependent rows solvable


def box_moves(
    H: Array, g: Array, low: Array, high: Array, A: Array | None = None, b: Array | None = None
) -> Moves:
    """Solve them.

    Args:
        H: Regular matrices, shape (N, n, n).
        g: Slopes, shape (N, n).
        low: Lower bounds of moves, <= 0, shape (N, n).
        high: Upper bounds, >= 0, shape (N, n).
        A: Rows, shape (N, m, n).
        b: What they ask for, shape (N, m).
    """
    at_low, at_high = (np.zeros(g.shape, dtype=np.bool_) for _ in range(2))
    for _ in range(_EXCHANGES):
        p, nu = _solved(H, g, np.where(at_low, low, high), at_low | at_high, A, b)
        force = (H @ p[:, :, None])[:, :, 0] + g
        if A is not None:
            force += (nu[:, None, :] @ A)[:, 0]
        below = np.where(at_low, force > 0.0, p < low)
        above = np.where(at_high, force < 0.0, p > high)
        if (below == at_low).all() and (above == at_high).all():
            break
        at_low, at_high = below, above & ~below
    force[~(at_low | at_high)] = 0.0
    return Moves(np.minimum(np.maximum(p, low), high), nu, force)


def _solved(
    H: Array, g: Array, bound: Array, held: NDArray[np.bool_], A: Array | None, b: Array | None
) -> tuple[Array, Array]:
    """Moves with some of them held at a bound, and the multipliers of the rows."""
    N, n = g.shape
    K, right = H, -g
    if held.any():
        p = np.where(held, bound, 0.0)
        right = np.where(held, p, right - (H @ p[:, :, None])[:, :, 0])
        K = np.where(held[:, :, None] | held[:, None, :], 0.0, H)
        K[:, range(n), range(n)] += held
    if A is None or b is None:
        p = np.array(np.linalg.solve(K, right[:, :, None])[:, :, 0], dtype=np.float64)
        return p, np.zeros((N, 0))
    m = A.shape[1]
    whole = np.zeros((N, n + m, n + m))
    free = A
    if held.any():
        b = b - (A @ p[:, :, None])[:, :, 0]
        free = np.where(held[:, None, :], 0.0, A)
    whole[:, :n, :n], whole[:, n:, :n], whole[:, :n, n:] = K, free, free.transpose(0, 2, 1)
    soft = _SOFT * np.abs(A).max(axis=(1, 2)) ** 2 / np.abs(H).max(axis=(1, 2))
    whole[:, range(n, n + m), range(n, n + m)] = -soft[:, None]
    right = np.concatenate((right, b), axis=1)[:, :, None]
    found = np.array(np.linalg.solve(whole, right)[:, :, 0], dtype=np.float64)
    return found[:, :n], found[:, n:]


class Moves(NamedTuple):
    """Answers, one a frame.

    Attributes:
        p: Moves, shape (N, n).
        nu: Multipliers of the rows, H p + g + A' nu = force of bounds, shape (N, m).
        force: Of the bounds, > 0 at a lower one, shape (N, n).
    """

    p: Array
    nu: Array
    force: Array
