"""The quadratic program of a move of all joints onto linear rows, within bounds.

    min 1/2 p' W p + f' p   subject to   J p = c,   low <= p <= high
    W p + f = J' lam + mu,   mu >= 0 at `low`, mu <= 0 at `high`, 0 elsewhere

`core/projection` asks it of each step to the nearest consistent state. W may leave joints free
that the rows place. Source: J. Nocedal, S. Wright, Numerical Optimization, 2006, sec. 16.2.
"""

from typing import Any, NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.optimization.limit_forces import LimitForces
from mbd_ros.core.rows.row_factor import RowFactor
from mbd_ros.core.state import Array


class Metric(NamedTuple):
    """W, and row weights that keep the problem solvable.

    Attributes:
        W: Positive semidefinite, shape (n, n).
        weight: Row weights s: W + J' s J is definite; None where W itself is, shape (m,).
    """

    W: Array
    weight: Array | None


def row_weight(M: Array, J: Array) -> Array:
    """Weights that bring the rows to the size of the mass matrix, shape (m,)."""
    size = (J * eigenpy.LLT(M).solve(J.T).reshape(J.T.shape).T).sum(axis=1)
    return 1.0 / np.where(size > 0.0, size, 1.0)


def is_convex(metric: Metric, J: Array) -> bool:
    """Whether the problem has one minimum."""
    rows = J.T if metric.weight is None else J.T * metric.weight
    return bool(eigenpy.LLT(metric.W + rows.dot(J)).info().name == "Success")


class Move(NamedTuple):
    """The optimum.

    Attributes:
        p: Move, shape (n,).
        lam: Multipliers of the rows, shape (m,).
        mu: Multipliers of the bounds, shape (n,).
        condition: Condition number of the rows in the metric, inf where they are redundant.
    """

    p: Array
    lam: Array
    mu: Array
    condition: float


class MoveQp:
    """Solves the problem above: one factorisation, and a QP only where a bound is violated.

    Args:
        n: Number of joints.
        limits: Forces of the bounds.
    """

    def __init__(self, n: int, limits: LimitForces) -> None:
        self._limits = limits
        self._zero = np.zeros(n)

    def solve(self, metric: Metric, f: Array, J: Array, c: Array, low: Array, high: Array) -> Move:
        """The optimum; arguments as in the problem above.

        Raises:
            SolveError: The bounds contradict the rows, or something is not finite.
        """
        W, weight = metric
        if weight is not None:  # nothing changes where J p = c
            rows = J.T * weight
            W, f = W + rows.dot(J), f - rows.dot(c)
        on_rows = _OnRows(W, J)
        free = -_solve(on_rows.cholesky, f)
        p, lam = on_rows.nearest(c, free)
        mu = self._limits.solve(on_rows, p, low, high)
        if mu is not None:
            p, lam = on_rows.nearest(c, free + _solve(on_rows.cholesky, mu))
        return Move(p, lam, self._zero if mu is None else mu, on_rows.condition)


class _OnRows:
    """Moves that keep J p."""

    def __init__(self, W: Array, J: Array) -> None:
        self._J, self.cholesky = J, eigenpy.LLT(W)
        self._factor = RowFactor(W, J) if len(J) else None
        self.condition = 1.0 if self._factor is None else self._factor.condition

    def nearest(self, c: Array, p: Array) -> tuple[Array, Array]:
        """Point p moved onto J p = c, and the multipliers of the rows."""
        if self._factor is None:
            return p, np.zeros(0)
        lam = self._factor.solve(c - self._J.dot(p))
        return p + self._factor.X.dot(lam), lam

    def moves(self, forces: Array) -> Array:
        """Moves that forces cause, one a column."""
        moves = _solve(self.cholesky, forces)
        if self._factor is not None:
            moves -= self._factor.motion(self._factor.X.T.dot(forces))
        return moves

    def mobility(self) -> Array:
        """Moves per force of each joint if there were no rows, shape (n,)."""
        return np.array(_solve(self.cholesky, np.eye(len(self._J.T))).diagonal())


def _solve(factored: Any, right: Array) -> Array:
    """Solution of the shape of `right`; eigenpy flattens one column and not one number."""
    solution: Array = factored.solve(right).reshape(right.shape)
    return solution
