"""Equations of rows that may depend on one another: A x + b = 0.

A is the mobility of the rows, not symmetric where contacts slip. Source of the pseudo-inverse:
G. H. Golub, C. F. Van Loan, Matrix Computations, 2013, sec. 5.5.
"""

import eigenpy
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, redundant
from mbd_ros.errors import SolveError


def balanced(A: Array, b: Array, unit: Array) -> tuple[Array, bool]:
    """An x with A x + b = 0, and whether there are others.

    It is NaN where A is not finite: of a state that diverges, which its simulation reports.

    Args:
        A: Shape (n, n), n > 0.
        b: Shape (n,).
        unit: Values of x that change the rows about alike, shape (n,).

    Raises:
        SolveError: There is none.
    """
    scaled, right = unit[:, None] * A * unit, unit * b
    if not np.isfinite(scaled).all():
        return np.full(len(b), np.nan), False
    n = len(b)
    factor = eigenpy.CompleteOrthogonalDecomposition(n, n)
    factor.setThreshold(redundant(n))
    factor.compute(scaled)
    found = factor.solve(right).reshape(-1)
    found -= factor.solve(scaled.dot(found) - right).reshape(-1)
    _check(scaled, found, right)
    return -unit * found, factor.rank() < n


def least_balanced(A: Array, b: Array, unit: Array) -> tuple[Array, bool]:
    """The smallest x with A x + b = 0, and whether there are others; as `balanced`."""
    scaled, right = unit[:, None] * A * unit, unit * b
    if not np.isfinite(scaled).all():
        return np.full(len(b), np.nan), False
    U, s, Vt = np.linalg.svd(scaled)
    n = int(np.count_nonzero(s > redundant(len(b)) * s[0]))
    left, ahead, null = U[:, :n].T, Vt[:n].T / s[:n], Vt[n:]
    found = ahead.dot(left.dot(right))
    found -= ahead.dot(left.dot(scaled.dot(found) - right))  # what unequal masses leave
    _check(scaled, found, right)
    found *= -unit
    if len(null) == 1:
        along = unit * null[0]
        found -= along * (along.dot(found) / along.dot(along))
    elif len(null):
        same = np.linalg.qr((null * unit).T)[0]
        found -= same.dot(same.T.dot(found))
    return found, len(null) > 0


def _check(A: Array, x: Array, b: Array) -> None:
    left = np.abs(A.dot(x) - b).max()
    if left > 0.0 and left > CONTRADICTION * (np.abs(A).dot(np.abs(x)) + np.abs(b)).max():
        raise SolveError("rows of a contact and those beside it contradict one another")
