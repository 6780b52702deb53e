"""A move of all joints onto linear rows, within bounds.

    min 1/2 p' W p + f' p   subject to   J p = c,   low <= p <= high
    W p + f = J' lam + mu,   mu >= 0 at `low`, mu <= 0 at `high`, 0 elsewhere

`methods/projection` asks it of each step to the nearest consistent state. W may leave joints free
that the rows place. `LimitForces` finds the mu for any compliance C of the joints,

    w = p + C mu,   low <= w <= high

where p is the move without limits and C the moves per force that constraints leave. Where C is
regular, w is the optimum of min 1/2 (w - p)' C^-1 (w - p) over low <= w <= high.
Source: J. Nocedal, S. Wright, Numerical Optimization, 2006, sec. 16.2.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.box_qp import (
    BoxQp,
    Sides,
    Statistics,
    factored,
    least_norm,
    on_active_set,
    passed,
)
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CLOSED_GAP, HELD_BY_ROWS, REACHED
from mbd_ros.errors import SolveError

_DAMPING = 1.0e-6  # for the QP, whose check is relative to forces that A would not limit
_SLIGHT = 1.0e-10  # the same while bounds are exchanged
_ROUNDING = 1.0e-14  # a gap of that size is none; scaled gaps are of the order of 1 or less
_EXCHANGES = 6


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
        self._J = J
        self.cholesky = eigenpy.LLT(W)
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


class Metric(NamedTuple):
    """W, and row weights that keep the problem solvable.

    Attributes:
        W: Positive semidefinite, shape (n, n).
        weight: Row weights s: W + J' s J is definite; None where W itself is, shape (m,).
    """

    W: Array
    weight: Array | None


class LimitForces:
    """Solver for the multipliers mu of the problem above, for any compliance.

    It is a primal-dual active-set method that starts from the last active set: limits with a
    multiplier of the wrong sign leave, violated limits join. If it does not converge, a QP in mu
    is solved.

    Source: M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13 (2002).

    Args:
        n: Number of joints.
        bounded: Whether bounds may be finite; otherwise no QP solver is imported.

    Attributes:
        solves: Number of solves with an active limit.
    """

    def __init__(self, n: int, bounded: bool) -> None:
        self._pushers = ComplementarityProblem(2 * n) if bounded else None
        self._identity = np.eye(n)
        self._active: Sides = np.zeros(n, dtype=np.int8)
        self.solves = 0

    @property
    def statistics(self) -> Statistics:
        """Statistics of the QPs."""
        return Statistics() if self._pushers is None else self._pushers.statistics

    def solve(self, compliance: Compliance, p: Array, low: Array, high: Array) -> Array | None:
        """Return the multipliers mu, shape (n,), or None if p is within the bounds.

        Args:
            compliance: Compliance of the joints.
            p: Step without bounds, shape (n,).
            low: Smallest step, shape (n,).
            high: Largest step, shape (n,).

        Raises:
            SolveError: The bounds contradict the constraints, or something is not finite.
        """
        if self._pushers is None or not ((p < low) | (p > high)).any():
            return None
        self.solves += 1
        mu = self._by_exchange(compliance, p, low, high)
        if mu is None:
            A, gap, scale = _pushes(compliance, p, low, high)
            at_lower, at_upper = np.split(scale * self._pushers.solve(A, gap), 2)
            mu = at_lower - at_upper
        self._active = np.sign(mu).astype(np.int8)
        return mu

    def _by_exchange(
        self, compliance: Compliance, p: Array, low: Array, high: Array
    ) -> Array | None:
        """Return mu if exchanges converge soon with independent limits, otherwise None."""
        active = self._active if self._active.any() else passed(p, low, high)
        for _ in range(_EXCHANGES):
            bound = np.where(active > 0, low, high)
            rows = (np.isfinite(bound) & (active != 0)).nonzero()[0]
            if not len(rows):
                return None
            pushes, gap = self._identity[:, rows], bound[rows] - p[rows]
            moves = compliance.moves(pushes)
            force = factored(moves[rows], gap)
            moved, slack = p + moves.dot(force), CLOSED_GAP * float(np.abs(gap).max())
            pulls = force * active[rows] < 0.0
            beyond = (moved < low - slack) | (moved > high + slack)
            if not (pulls.any() or beyond.any()):
                closed = np.abs(moved[rows] - bound[rows]) <= slack
                return pushes.dot(force) if closed.all() else None
            active = np.where(beyond, passed(moved, low, high), active)
            active[rows[pulls]] = 0
        return None


class Compliance(Protocol):
    """Compliance C of the joints: steps per force."""

    def moves(self, forces: Array) -> Array:
        """Return C times forces, one per column, shape (n, k)."""

    def mobility(self) -> Array:
        """Return the steps per force of each joint without constraints, shape (n,)."""


def _pushes(compliance: Compliance, p: Array, low: Array, high: Array) -> tuple[Array, ...]:
    """Return scaled A and gap of forces >= 0 at lower and upper bounds, and the scales."""
    n = len(p)
    C, mobility = compliance.moves(np.eye(n)), np.tile(compliance.mobility(), 2)
    sides, gap = np.repeat([1.0, -1.0], n), np.concatenate([p - low, high - p])
    A = sides[:, None] * np.tile(0.5 * (C + C.T), (2, 2)) * sides
    movable = np.isfinite(gap) & (A.diagonal() > HELD_BY_ROWS * mobility)
    scale = np.where(movable, 1.0 / np.sqrt(np.where(movable, A.diagonal(), 1.0)), 0.0)
    return scale[:, None] * A * scale, scale * np.where(movable, gap, 0.0), scale


class ComplementarityProblem:
    """Linear complementarity problem of unilateral bounds.

        w = A f + gap,   f >= 0,   w >= 0,   f' w = 0

    A is positive semidefinite with ones on its diagonal. It is singular if joints are coupled,
    since then two of their bounds may coincide. Every solution is exact on its active bounds, and
    checked. The last active set is tried first, then that of a QP. If the QP fails, or its damping
    leads to a wrong set, bounds are exchanged one by one until all conditions hold.

    Source: R. Cottle, J.-S. Pang, R. Stone, The Linear Complementarity Problem, 1992.

    Args:
        n: Number of bounds.
    """

    def __init__(self, n: int) -> None:
        self._qp = BoxQp(n)
        self._identity = np.eye(n)
        self._none = np.zeros(n)
        self._infinite = np.full(n, np.inf)
        self._active = np.zeros(n, dtype=np.bool_)

    @property
    def statistics(self) -> Statistics:
        """Statistics of the QPs."""
        return self._qp.statistics

    def solve(self, A: Array, gap: Array) -> Array:
        """Return the forces, shape (n,), of minimum norm if bounds are redundant.

        Raises:
            SolveError: There is no solution: the bounds contradict the constraints.
        """
        if not (np.isfinite(A).all() and np.isfinite(gap).all()):
            raise SolveError("mobilities or distances to limits are not finite")
        force = _closing(A, gap, self._active)
        if not _holds(A, gap, force):
            guess = self._guess(A, gap)
            force = _closing(A, gap, guess > 0.0)
            if not _holds(A, gap, force):
                force = _exchanged(A, gap, guess)
            if not _holds(A, gap, force):
                raise SolveError("the joint limits contradict the constraints")
        self._active = force > 0.0
        return force

    def _guess(self, A: Array, gap: Array) -> Array:
        """Return a guess of the forces >= 0 by the QP, or zeros if it fails."""
        try:
            damped = A + _DAMPING * self._identity
            return np.maximum(self._qp.solve(damped, gap, self._none, self._infinite), 0.0)
        except SolveError:
            return self._none


def _closing(A: Array, gap: Array, active: NDArray[np.bool_]) -> Array:
    """Return the forces of minimum norm that close the gaps of the active bounds."""
    return on_active_set(A, gap, np.zeros(len(gap)), active, least_norm)


def _holds(A: Array, gap: Array, force: Array) -> bool:
    """Whether forces satisfy the complementarity conditions."""
    left, least = A.dot(force) + gap, _least(gap)
    is_open = (left > least) & (force > 0.0)
    return bool((left >= -least).all() and (force >= 0.0).all() and not is_open.any())


def _least(gap: Array) -> Array:
    """Return the tolerance of each gap."""
    return CLOSED_GAP * (np.abs(gap) - min(float(gap.min()), 0.0)) + _ROUNDING


def _exchanged(A: Array, gap: Array, force: Array) -> Array:
    """Exchange bounds one at a time, starting from forces >= 0.

    Source: C. Lawson and R. Hanson, Solving Least Squares Problems, 1974, ch. 23.
    """
    slight, none = A + _SLIGHT * np.eye(len(A)), np.zeros(len(gap))
    active = force > 0.0
    for _ in range(4 * len(gap)):
        target = on_active_set(slight, gap, none, active)
        pulls = (active & (target <= 0.0)).nonzero()[0]
        if len(pulls):
            shares = force[pulls] / np.maximum(force[pulls] - target[pulls], _ROUNDING)
            force = force + shares.min() * (target - force)
            active[pulls[shares.argmin()]] = False
            force = np.where(active, np.maximum(force, 0.0), 0.0)
            continue
        force = target
        left = np.where(active, 0.0, A.dot(force) + gap)
        if (left >= -_least(gap)).all():
            break
        active[left.argmin()] = True
    return _closing(A, gap, active)


def row_weight(M: Array, J: Array) -> Array:
    """Weights that bring the rows to the size of the mass matrix, shape (m,)."""
    size = (J * eigenpy.LLT(M).solve(J.T).reshape(J.T.shape).T).sum(axis=1)
    return 1.0 / np.where(size > 0.0, size, 1.0)


def stops(q: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Smallest and largest velocities, shapes (n,), that do not lead out of a reached limit.

    Args:
        q: Configuration, shape (n,).
        lower: Smallest positions, shape (n,).
        upper: Largest positions, shape (n,).
    """
    floor = np.where(q <= lower + REACHED, 0.0, -np.inf)
    return floor, np.where(q >= upper - REACHED, 0.0, np.inf)


def is_convex(metric: Metric, J: Array) -> bool:
    """Whether the problem has one minimum."""
    rows = J.T if metric.weight is None else J.T * metric.weight
    return bool(eigenpy.LLT(metric.W + rows.dot(J)).info().name == "Success")
