"""The best move onto linear rows within bounds, in a metric that may leave joints free.

min 1/2 p' W p + f' p   subject to   J p = c,   low <= p <= high
W p + f = J' lam + mu,   mu >= 0 at `low`, mu <= 0 at `high`, 0 elsewhere
"""

from typing import Any, NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.pushing_bounds import PushingBounds
from mbd_ros.core.qp import Statistics
from mbd_ros.core.row_factor import RowFactor
from mbd_ros.core.state import Array

_CLOSED = 1.0e-12  # of the largest gap: what may be left where the same bounds act again
_BLOCKED = 1.0e-12  # what the rows leave of the mobility of a joint that they fix
_SHARE = 0.1  # of a free direction from which a joint counts as free


class Metric(NamedTuple):
    """W and what keeps it solvable.

    Attributes:
        W: Positive semidefinite, shape (n, n).
        weight: Row weights s: W + J' s J is definite; None where W itself is, shape (m,).
        undetermined: Joints without measurement that the rows leave free, shape (n,).
    """

    W: Array
    weight: Array | None
    undetermined: NDArray[np.bool_]


def metric_of(M: Array, J: Array, known: NDArray[np.bool_], amplification: float) -> Metric:
    """Mass metric of the measured joints.

    A joint that was not measured costs nothing to move, so that the rows alone place it. What
    the rows leave free, or would place with errors larger than those of the measured joints by
    more than `amplification`, keeps its mass: it stays where it is, as far as the rows let it.

    Args:
        M: Mass matrix, shape (n, n).
        J: Rows, shape (m, n).
        known: Measured joints, shape (n,).
        amplification: See above; in raw units, rad and m alike.
    """
    undetermined = np.zeros(len(M), dtype=np.bool_)
    if known.all():
        return Metric(M, None, undetermined)
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
    return Metric(W, row_weight(M, J), undetermined)


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


class NearestPoint:
    """Solves the problem above: one factorisation, and a QP only where a bound is violated.

    The QP is in the multipliers of the bounds, with the rows eliminated. The bounds that acted
    last are tried before it.

    Args:
        n: Number of joints.
        bounded: Whether bounds may ever be finite; without, no QP solver is imported.

    Attributes:
        bounded_solves: How often a bound acted.
    """

    def __init__(self, n: int, bounded: bool) -> None:
        self._pushers = PushingBounds(2 * n) if bounded else None
        self._acting, self._signs = np.zeros(0, dtype=np.intp), np.zeros(0)
        self._sides = np.repeat([1.0, -1.0], n)
        self._zero, self._none, self._identity = np.zeros(n), np.zeros(0), np.eye(n)
        self.bounded_solves = 0

    @property
    def statistics(self) -> Statistics:
        """How the QPs went."""
        return Statistics() if self._pushers is None else self._pushers.statistics

    def solve(self, metric: Metric, f: Array, J: Array, c: Array, low: Array, high: Array) -> Move:
        """The optimum; arguments as in the problem above.

        Raises:
            SolveError: The bounds contradict the rows, or something is not finite.
        """
        W, weight, _ = metric
        if weight is not None:  # nothing changes where J p = c
            rows = J.T * weight
            W, f = W + rows.dot(J), f - rows.dot(c)
        cholesky = eigenpy.LLT(W)
        factor = RowFactor(W, J) if len(J) else None
        free = -_solve(cholesky, f)
        p, lam = self._onto_rows(factor, J, c, free)
        mu = self._zero
        if self._pushers is not None and ((p < low).any() or (p > high).any()):
            self.bounded_solves += 1
            same = self._as_before(cholesky, factor, p, low, high)
            mu = self._bound_forces(cholesky, factor, p, low, high) if same is None else same
            self._acting = mu.nonzero()[0]
            self._signs = np.sign(mu[self._acting])
            p, lam = self._onto_rows(factor, J, c, free + _solve(cholesky, mu))
        return Move(p, lam, mu, 1.0 if factor is None else factor.condition)

    def _onto_rows(
        self, factor: RowFactor | None, J: Array, c: Array, p: Array
    ) -> tuple[Array, Array]:
        """P moved onto the rows, and their multipliers."""
        if factor is None:
            return p, self._none
        lam = factor.solve(c - J.dot(p))
        return p + factor.X.dot(lam), lam

    def _as_before(
        self, cholesky: Any, factor: RowFactor | None, p: Array, low: Array, high: Array
    ) -> Array | None:
        """Mu if the bounds that acted last are the right ones, else None."""
        rows, sign = self._acting, self._signs
        if not len(rows):
            return None
        pushes = self._identity[:, rows] * sign
        moves = _compliance(cholesky, factor, pushes)
        bound = np.where(sign > 0.0, low[rows], high[rows])
        gap = sign * (p[rows] - bound)
        force = -_solve(eigenpy.LDLT(sign[:, None] * moves[rows]), gap)
        if not ((force >= 0.0) & (force < np.inf)).all():
            return None
        moved = p + moves.dot(force)
        slack = _CLOSED * float(np.abs(gap).max())
        closed = np.abs(moved[rows] - bound) <= slack
        if not (closed.all() and (moved >= low - slack).all() and (moved <= high + slack).all()):
            return None
        return pushes.dot(force)

    def _bound_forces(
        self, cholesky: Any, factor: RowFactor | None, p: Array, low: Array, high: Array
    ) -> Array:
        """Mu that keeps p within the bounds: a force >= 0 at each lower and each upper one."""
        assert self._pushers is not None
        mobility = np.tile(_solve(cholesky, self._identity).diagonal(), 2)
        P = _compliance(cholesky, factor, self._identity)
        gap = np.concatenate([p - low, high - p])
        A = self._sides[:, None] * np.tile(0.5 * (P + P.T), (2, 2)) * self._sides
        movable = np.isfinite(gap) & (A.diagonal() > _BLOCKED * mobility)
        scale = np.where(movable, 1.0 / np.sqrt(np.where(movable, A.diagonal(), 1.0)), 0.0)
        scaled = scale[:, None] * A * scale, scale * np.where(movable, gap, 0.0)
        force = scale * self._pushers.solve(*scaled)
        return force[: len(p)] - force[len(p) :]


def _compliance(cholesky: Any, factor: RowFactor | None, forces: Array) -> Array:
    """Moves that forces cause, one a column, rows kept."""
    moves = _solve(cholesky, forces)
    if factor is not None:
        moves -= factor.X.dot(factor.solve(factor.X.T.dot(forces)))
    return moves


def _solve(factored: Any, right: Array) -> Array:
    """Solution of the shape of `right`; eigenpy flattens one column and not one number."""
    return factored.solve(right).reshape(right.shape)
