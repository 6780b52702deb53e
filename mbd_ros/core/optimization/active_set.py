"""What the active-set methods of this folder share: the rows that act, and solves on them.

    A x + b = 0 in the free rows,   x = bound in the others

A is symmetric and positive semidefinite. It is singular where rows depend on one another; each
solve below says what it gives then. Source: J. Nocedal, S. Wright, Numerical Optimization, 2006,
ch. 16; G. H. Golub, C. F. Van Loan, Matrix Computations, 2013, sec. 5.4 and 5.5, on ranks.
"""

from collections.abc import Callable

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import FIXED_BY_OTHERS, NEARLY_SINGULAR, redundant

Sides = NDArray[np.int8]  # 1 at a lower limit, -1 at an upper one, 0 between them


def passed(values: Array, lower: Array, upper: Array, slack: float = 0.0) -> Sides:
    """The limits that values pass by more than a slack; a negative slack tells who is near."""
    below, above = values < lower - slack, values > upper + slack
    return below.astype(np.int8) - (above & ~below)


def factored(A: Array, r: Array) -> Array:
    """The x with A x = r; where A is singular, what its factor leaves, for the caller to judge."""
    return eigenpy.LDLT(A).solve(r).reshape(r.shape)  # eigenpy flattens one column


def least_norm(A: Array, r: Array) -> Array:
    """The x of smallest norm with A x nearest to r."""
    return np.asarray(np.linalg.lstsq(A, r, rcond=redundant(len(A)))[0], dtype=np.float64)


def on_active_set(
    A: Array,
    b: Array,
    bound: Array,
    free: NDArray[np.bool_],
    solve: Callable[[Array, Array], Array] = factored,
) -> Array:
    """The x of the equations above, shape (n,)."""
    rows = free.nonzero()[0]
    if len(rows) == len(b):
        return -solve(A, b)
    x = np.where(free, 0.0, bound)
    if len(rows):
        A_rows = A[rows]
        x[rows] = -solve(A_rows[:, rows], A_rows.dot(x) + b[rows])
    return x


def on_independent(rows: Array, bound: Array) -> tuple[Array, Array] | None:
    """The smallest y with rows y = bound and its multipliers; None where rows depend on others."""
    count, n = rows.shape
    if count == 0:
        return np.zeros(n), np.zeros(0)
    if count > n:
        return None
    gram = eigenpy.LLT(rows.dot(rows.T))
    if gram.info().name != "Success" or not gram.rcond() > NEARLY_SINGULAR:
        return None
    force = gram.solve(bound).reshape(-1)
    return force.dot(rows), force


def pseudo_inverse(rows: Array) -> Array:
    """The pseudo-inverse; what is shorter than `FIXED_BY_OTHERS` counts as nothing."""
    length = float(np.sqrt((rows * rows).sum(axis=0).max(initial=0.0)))
    if not length > FIXED_BY_OTHERS:
        return np.zeros(rows.shape[::-1])
    factor = eigenpy.CompleteOrthogonalDecomposition(*rows.shape)
    factor.setThreshold(FIXED_BY_OTHERS / length)
    factor.compute(rows)
    return factor.pseudoInverse().reshape(rows.shape[::-1])
