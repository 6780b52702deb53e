"""Optimality of the box-constrained problem of `qp`, and its exact solution near a given one."""

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

_TINY = 1.0e-300
_NOTHING = 1.0e-12  # terms of that size are none
_DWARFS = 1.0e5
_POLISH_STEPS = 10
_POLISHED = 1.0e-12  # complementarity residual beyond which nothing is to be gained
_RANK = 1.0e-13


def complementarity(A: Array, b: Array, lower: Array, upper: Array, lam: Array) -> float:
    """Largest violation of the optimality conditions, relative to the terms in A lam + b.

    It is the natural residual: how far a gradient step, kept in the bounds, moves. Multipliers
    whose terms dwarf b come from a singular factor, and do not excuse what they leave.
    """
    given = np.abs(b)
    terms = np.abs(A).dot(np.abs(lam))
    size = np.minimum(terms, _DWARFS * given.max(initial=0.0)) + given + _NOTHING
    diagonal = np.maximum(A.diagonal(), _TINY)
    step = (A.dot(lam) + b) / diagonal  # kept apart from lam, which might swallow it
    moved = np.minimum(np.maximum(step, lam - upper), lam - lower) * diagonal
    worst = float((np.abs(moved) / size).max())
    return worst if worst < np.inf else np.inf


def _stepped(A: Array, b: Array, lower: Array, upper: Array, lam: Array) -> Array:
    """Lam after a gradient step of the length of its diagonal entry, kept in the bounds."""
    target = lam - (A.dot(lam) + b) / np.maximum(A.diagonal(), _TINY)
    return np.minimum(np.maximum(target, lower), upper)


def polish(A: Array, b: Array, lower: Array, upper: Array, lam: Array) -> Array:
    """The exact solution near lam, by Newton's method on the natural residual; else the best.

    Source: Hintermüller, Ito, Kunisch, SIAM J. Optim. 13 (2002), the primal-dual active set.
    """
    best, least = lam, complementarity(A, b, lower, upper, lam)
    for _ in range(_POLISH_STEPS):
        if least <= _POLISHED:
            break
        stepped = _stepped(A, b, lower, upper, lam)
        free = (stepped > lower) & (stepped < upper)
        lam = np.minimum(np.maximum(on_active_set(A, b, stepped, free), lower), upper)
        residual = complementarity(A, b, lower, upper, lam)
        if residual > _POLISHED:  # singular: the shortest way from where it is
            rows = free.nonzero()[0]
            lam, right = stepped.copy(), -(A.dot(stepped) + b)[rows]
            lam[rows] += np.linalg.lstsq(A[np.ix_(rows, rows)], right, rcond=_RANK)[0]
            lam = np.minimum(np.maximum(lam, lower), upper)
            residual = complementarity(A, b, lower, upper, lam)
        if residual < least:
            best, least = lam, residual
    return best


def on_active_set(A: Array, b: Array, bound: Array, free: NDArray[np.bool_]) -> Array:
    """Lam with A lam + b = 0 in the free rows and lam = `bound` in the others, shape (n,).

    Singular rows give what their factor leaves: whoever asks judges the result.
    """
    rows = free.nonzero()[0]
    if len(rows) == len(b):
        return -eigenpy.LDLT(A).solve(b).reshape(-1)
    lam = np.where(free, 0.0, bound)
    if len(rows):
        A_rows = A[rows]
        right = A_rows.dot(lam) + b[rows]
        lam[rows] = -eigenpy.LDLT(A_rows[:, rows]).solve(right).reshape(-1)
    return lam
