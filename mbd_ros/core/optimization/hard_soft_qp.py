"""Minimum-norm vectors within hard and soft limits, for tracking control.

    min 1/2 |y|²   subject to   lower <= G y <= upper

The first n rows of G, a regular matrix, are hard. If the soft limits cannot all be satisfied, the
sum of (excess / |row|)² is minimised first, and then |y|². In the controller `qp_tracking`, the
limits of drives are hard and those of joint motion are soft.

`candidate` is the exact optimum for a given active set, in this order: the hard rows, the smallest
excess of the soft rows, the smallest y. `HardSoftQp` finds the active set.

Source: A. Escande, N. Mansard, P. Wieber, Int. J. Robotics Research 33(7) (2014).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.optimization.box_qp import Sides, on_independent, passed, pseudo_inverse
from mbd_ros.core.optimization.qp_solvers import WarmProxQp, counted
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CLOSED_GAP, FIXED_BY_OTHERS, TINY
from mbd_ros.errors import SolveError

_NO_EXCESS = 1.0e-10  # of the largest gap
_COMPLIANCE = 1.0e-6  # of a soft row of length one
_ACTS = 1.0e-7  # smallest multiplier of an active limit, for a largest gap of 1
_AT_LIMIT = 1.0e-9  # of the largest gap
_CHANGES = 4  # changes of the active set per guess
COMPLIANCES = (1.0e-2, 1.0e-5, 1.0e-8, 1.0e-11)
_EVENTS = 60  # for each compliance
_PULLS = 1.0e-9  # of the largest gradient: multipliers below count as zero
_EXCHANGES = 30
_KEPT = 1.0e-10  # relative tolerance of bounds
_PUSHES = 1.0e-12  # of the largest multiplier: multipliers below count as zero


class HardSoftQp:
    """Solver of the problem above; solutions are exact on their active set, and checked.

    Guesses of the active set are tried in this order: the set that was active twice before; the
    set of a warm-started ProxQP with slightly compliant soft rows; the same with a cold start; and
    that of a descent in the box of the hard rows. For each guess the optimality conditions are
    recomputed, and limits that violate them are exchanged. As a last resort, the result of the
    descent is used, whose excess is nearly minimal.

    Args:
        n: Size of y, and number of hard rows.
        soft: Number of soft rows.

    Raises:
        ModelError: proxsuite is not installed.
    """

    def __init__(self, n: int, soft: int) -> None:
        self.counts = Counts()
        size = n + soft
        self._n = n
        self._qp = WarmProxQp(size, soft)
        self._H = np.zeros((size, size))
        self._g = np.zeros(size)
        self._C = np.zeros((soft, size))
        self._C[:, n:] = _COMPLIANCE**0.5 * np.eye(soft)
        self._yielding = np.arange(n, size)
        self._low = np.full(size, -np.inf)
        self._high = np.full(size, np.inf)
        self._side: Sides = np.zeros(size, dtype=np.int8)
        self._is_steady = False  # whether the same limits acted twice

    def solve(self, G: Array, lower: Array, upper: Array) -> Candidate:
        """Return the optimum.

        Args:
            G: Rows, shape (n + soft, n).
            lower: Lower limits, shape (n + soft,), -inf for none.
            upper: Upper limits, >= lower, shape (n + soft,), inf for none.

        Raises:
            SolveError: The input is not finite, lower > upper, or the hard rows are singular.
        """
        if not (np.isfinite(G).all() and (lower <= upper).all()):
            raise SolveError("QP refused: a row is not finite, or lower > upper")
        self.counts = counted(self.counts, "solves")
        G, lower, upper = self._scaled(G, lower, upper)
        size = max(float(lower.max()), float(-upper.min()), TINY)
        try:
            solution = self._exact(G, lower, upper, size) or self._damped(G, lower, upper, size)
        except np.linalg.LinAlgError as error:
            self.counts = counted(self.counts, "failed")
            raise SolveError(f"QP not solved: {error}") from error
        if solution.is_softened:
            self.counts = counted(self.counts, "softened")
        self._is_steady = bool((solution.side == self._side).all())
        self._side = solution.side
        return solution

    def _scaled(self, G: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Scale rows to length one, and remove the limits of rows that y cannot move."""
        length = np.sqrt((G * G).sum(axis=1))
        soft = length[self._n :]
        scale = 1.0 / np.maximum(length, TINY)
        low, high = scale * lower, scale * upper
        unmoved = self._n + (soft <= FIXED_BY_OTHERS * soft.max(initial=0.0)).nonzero()[0]
        scale[unmoved], low[unmoved], high[unmoved] = 0.0, -np.inf, np.inf
        return scale[:, None] * G, low, high

    def _exact(self, G: Array, lower: Array, upper: Array, size: float) -> Candidate | None:
        if self._is_steady:
            solution = candidate(G, lower, upper, self._side, self._n, size)
            if solution.is_optimal:
                return solution
        E: Any = np.linalg.inv(G[: self._n])
        C = G[self._n :].dot(E)
        for rung in ("qp", "cold", "boxed"):
            self.counts = counted(self.counts, rung)
            if rung == "boxed":
                _, side, _ = _boxed(G, lower, upper, size)
            else:
                scaled = lower / size, upper / size
                force = self._soft_forces(E, C, *scaled, cold=rung == "cold")
                side = np.where(np.abs(force) > _ACTS, np.sign(force), 0.0).astype(np.int8)
            for _ in range(_CHANGES):
                solution = candidate(G, lower, upper, side, self._n, size)
                if solution.is_optimal:
                    return solution
                side = solution.side
        return None

    def _soft_forces(self, E: Array, C: Array, lower: Array, upper: Array, *, cold: bool) -> Array:
        """Multipliers where soft rows yield a little, > 0 where the lower limit acts.

        min 1/2 |E x|² + 1/2 |e|²   subject to   lower <= (x, C x + sqrt(compliance) e) <= upper
        """
        n, soft, cost = self._n, len(C), E.T.dot(E)
        unit = 1.0 / float(cost.diagonal().max())  # residuals of ProxQP are absolute
        self._H[:n, :n], self._C[:, :n] = unit * cost, C
        self._H[self._yielding, self._yielding] = unit
        self._low[:n], self._high[:n] = lower[:n], upper[:n]
        rows = self._C, lower[n:], upper[n:]
        self._qp.solve(self._H, self._g, self._low, self._high, rows, cold=cold)
        z = self._qp.multipliers / unit
        return -np.concatenate([z[soft : soft + n], z[:soft]])

    def _damped(self, G: Array, lower: Array, upper: Array, size: float) -> Candidate:
        self.counts = counted(self.counts, "damped")
        y, side, is_softened = _boxed(G, lower, upper, size)
        return Candidate(y, side, is_softened, False)


class Counts(NamedTuple):
    """How the solves of a `HardSoftQp` went.

    Attributes:
        solves: Problems in all.
        softened: Those whose soft rows cannot all be kept.
        qp: Those that reached ProxQP.
        cold: Those that needed a restart from nothing.
        boxed: Those that ProxQP did not solve.
        damped: Those that end with soft rows that yield a little more than they must.
        failed: Those without an answer.
    """

    solves: int = 0
    softened: int = 0
    qp: int = 0
    cold: int = 0
    boxed: int = 0
    damped: int = 0
    failed: int = 0


def candidate(
    G: Array, lower: Array, upper: Array, side: Sides, hard: int, size: float
) -> Candidate:
    """Return the smallest y for a guess of the active set.

    Args:
        G: Rows of length one, the hard ones first, shape (m, n).
        lower: Lower limits, shape (m,).
        upper: Upper limits, shape (m,).
        side: Guess: 1 for a lower limit, -1 for an upper one, 0 for inactive, shape (m,).
        hard: Number of hard rows.
        size: Largest gap at y = 0.
    """
    bound = np.where(side > 0, lower, upper)
    side = np.where(np.isfinite(bound), side, 0).astype(np.int8)
    active = side.nonzero()[0]
    rows, signs, bound = G[active], side[active], bound[active]
    solution = on_independent(rows, bound)
    is_softened = False
    if solution is None:
        first = int(np.searchsorted(active, hard))
        y, force, is_softened = _on_dependent(rows, bound, first, size)
    else:
        y, force = solution
    after, reached, slack = side.copy(), G.dot(y), CLOSED_GAP * size
    pulls = (force * signs < 0.0) & (lower[active] < upper[active])
    after[active[pulls]] = 0
    idle = side == 0
    after[idle] = passed(reached, lower, upper, slack)[idle]
    is_optimal = bool((after == side).all() and np.isfinite(y).all())
    return Candidate(y, after, is_softened, is_optimal)


def _on_dependent(rows: Array, bound: Array, hard: int, size: float) -> tuple[Array, Array, bool]:
    """Return the smallest y of minimal excess of the soft rows among those on the hard rows.

    Returns:
        The y; numbers with the signs of the multipliers of all rows, which are those of the
        minimal excess or, where these vanish, those of the minimal |y|; and whether there is an
        excess.
    """
    H, S = rows[:hard], rows[hard:]
    onto_hard = pseudo_inverse(H)
    y = onto_hard.dot(bound[:hard])
    y = y + pseudo_inverse(S - S.dot(onto_hard).dot(H)).dot(bound[hard:] - S.dot(y))
    excess = bound[hard:] - S.dot(y)
    excess = np.where(np.abs(excess) > _NO_EXCESS * size, excess, 0.0)
    hard_force = -onto_hard.T.dot(excess.dot(S))
    force = np.concatenate([hard_force, excess])
    force = np.where(np.abs(force) > _NO_EXCESS * size, force, 0.0)
    idle = force == 0.0
    if idle.any():
        fixed, others = rows[~idle], rows[idle]
        onto_fixed = pseudo_inverse(fixed)
        others = others - others.dot(onto_fixed).dot(fixed)
        least = pseudo_inverse(others).T.dot(y - onto_fixed.dot(fixed.dot(y)))
        force[idle] = np.where(np.abs(least) > CLOSED_GAP * size, least, 0.0)
    return y, force, bool(excess.any())


def _boxed(G: Array, lower: Array, upper: Array, size: float) -> tuple[Array, Sides, bool]:
    """Return y for stiff soft rows, its active limits, and whether a soft limit is exceeded."""
    n = G.shape[1]
    E: Any = np.linalg.inv(G[:n])
    rows = BoundedLeastSquares(E, G[n:].dot(E), lower[n:], upper[n:])
    y = E.dot(rows.solve(lower[:n], upper[:n]))
    reached, slack = G.dot(y), _AT_LIMIT * size
    is_softened = bool(passed(reached, lower, upper, slack).any())
    return y, passed(reached, lower, upper, -slack), is_softened


class Candidate(NamedTuple):
    """Solution for a guess of the active set.

    Attributes:
        y: The optimum if the guess is right, shape (n,).
        side: Next guess, without limits of wrong sign and with those that y exceeds: 1 for a lower
            limit, -1 for an upper one, 0 for an inactive one, shape (m,).
        is_softened: Whether soft limits are exceeded.
        is_optimal: Whether the guess is right, so that y is the optimum.
    """

    y: Array
    side: Sides
    is_softened: bool
    is_optimal: bool


class BoundedLeastSquares:
    """Least-squares problem in a box with compliant rows: slow, but it always has a solution.

        min 1/2 |E x|² + 1/2 |excess of C x over its limits|² / compliance,   lower <= x <= upper

    It is solved for decreasing `COMPLIANCES` by a primal active-set method: each step goes from a
    point of the box towards the minimum for the active bounds and exceeded rows, up to the first
    bound or limit.

    Args:
        E: Regular matrix, shape (n, n).
        C: Compliant rows, shape (k, n).
        low: Lower limits of these rows, shape (k,), -inf for none.
        high: Upper limits of these rows, shape (k,), inf for none.

    Source: P. Stark, R. Parker, Computational Statistics 10 (1995), on bounds.
    """

    def __init__(self, E: Array, C: Array, low: Array, high: Array) -> None:
        self._E = E
        self._C = C
        self._low = low
        self._high = high
        self._all = np.concatenate([np.eye(len(E)), C])

    def solve(self, lower: Array, upper: Array) -> Array:
        """Return the x of minimal cost in the box, or the last iterate, shape (n,)."""
        x = np.clip(np.zeros(len(lower)), lower, upper)
        for compliance in COMPLIANCES:
            x = self._descended(x, lower, upper, compliance**-0.5)
        return x

    def _descended(self, x: Array, lower: Array, upper: Array, stiffness: float) -> Array:
        side = passed(self._C.dot(x), self._low, self._high)
        is_fixed = (x <= lower) | (x >= upper)
        for _ in range(_EVENTS):
            r, A = self._residuals(x, side, stiffness)
            step, free = np.zeros(len(x)), (~is_fixed).nonzero()[0]
            step[free] = np.linalg.lstsq(A[:, free], -r, rcond=None)[0]
            begin, end = self._pieces(side)
            moves, ends = self._all.dot(step), (np.append(lower, begin), np.append(upper, end))
            share = _step_shares(self._all.dot(x), moves, *ends)
            first = int(share.argmin())
            x = np.clip(x + min(float(share[first]), 1.0) * step, lower, upper)
            if share[first] < 1.0:
                i = first - len(x)
                if i < 0:
                    is_fixed[first] = True
                else:
                    side[i] = 0 if side[i] else -np.sign(moves[first])
                continue
            r, A = self._residuals(x, side, stiffness)
            slope = A.T.dot(r)
            pull = np.where(is_fixed, np.where(x <= lower, -slope, slope), 0.0)
            pull[lower >= upper] = 0.0
            if pull.max() <= _PULLS * np.abs(slope).max():
                break
            is_fixed[pull.argmax()] = False
        return x

    def _residuals(self, x: Array, side: Sides, stiffness: float) -> tuple[Array, Array]:
        rows = side.nonzero()[0]
        limit = np.where(side > 0, self._low, self._high)[rows]
        excess = self._C[rows].dot(x) - limit
        A = np.concatenate([self._E, stiffness * self._C[rows]])
        return np.concatenate([self._E.dot(x), stiffness * excess]), A

    def _pieces(self, side: Sides) -> tuple[Array, Array]:
        """Return the interval in which the current quadratic of each row is valid."""
        begin = np.where(side == 0, self._low, np.where(side < 0, self._high, -np.inf))
        end = np.where(side == 0, self._high, np.where(side > 0, self._low, np.inf))
        return begin, end


def _step_shares(x: Array, step: Array, begin: Array, end: Array) -> Array:
    """Return the fraction of the step up to the end of each value, inf without an end."""
    ahead = np.where(step > 0.0, end - x, begin - x)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(step == 0.0, np.inf, ahead / step)
    return np.maximum(share, 0.0)


class RowBoundedQp:
    """Strictly convex quadratic program with bounded rows, solved exactly on its active rows.

        min 1/2 x' H x + g' x   subject to   lower <= C x <= upper

    Rows and sizes may change from call to call. If the unconstrained optimum violates no row, as
    in most problems of an estimator, it is the solution. Otherwise ProxQP finds the active rows,
    and rows are exchanged until the optimality conditions hold.

    Source: J. Nocedal, S. Wright, Numerical Optimization, 2006, ch. 16.
    """

    def __init__(self) -> None:
        self._solver: WarmProxQp | None = None
        self._size = (0, 0)
        self._last: Sides | None = None

    def solve(self, H: Array, g: Array, C: Array, lower: Array, upper: Array) -> Optimum:
        """Return the optimum.

        Args:
            H: Positive definite matrix, shape (n, n).
            g: Linear term, shape (n,).
            C: Rows, shape (m, n).
            lower: Lower bounds of the rows, shape (m,), -inf for none.
            upper: Upper bounds of the rows, shape (m,), inf for none.

        Raises:
            SolveError: H is not positive definite, or the bounds contradict each other.
        """
        factor = eigenpy.LLT(H)
        if factor.info() != eigenpy.ComputationInfo.Success or (lower > upper).any():
            raise SolveError("the quadratic program is not convex, or a lower bound is above")
        free = -factor.solve(g).ravel()
        slack = _KEPT * (1.0 + np.abs(C).max(initial=0.0) * np.abs(free).max(initial=0.0))
        if not passed(C.dot(free), lower, upper, slack).any():
            self._last = None
            return Optimum(free, np.zeros(len(C)), 0.0)
        for sides in self._guesses(H, g, C, lower, upper):
            optimum = self._exchanged(factor, free, C, lower, upper, sides, slack)
            if optimum is not None:
                return optimum
        raise SolveError("the bounds of the quadratic program contradict one another")

    def _guesses(
        self, H: Array, g: Array, C: Array, lower: Array, upper: Array
    ) -> Iterator[Sides]:
        """Yield guesses of the active rows: those of the last solution, then those of ProxQP."""
        if self._last is not None and len(self._last) == len(C):
            yield self._last
        n, m = H.shape[0], len(C)
        if self._solver is None or self._size != (n, m):
            self._solver, self._size = WarmProxQp(n, m), (n, m)
        none = np.full(n, np.inf)
        for cold in (False, True):
            x = self._solver.solve(H, g, -none, none, (C, lower, upper), cold=cold)
            if np.isfinite(x).all():
                near = 1.0e-6 * (1.0 + float(np.abs(x).max(initial=0.0)))
                yield passed(C.dot(x), lower, upper, -near)

    def _exchanged(
        self,
        factor: Any,
        free: Array,
        C: Array,
        lower: Array,
        upper: Array,
        sides: Sides,
        slack: float,
    ) -> Optimum | None:
        """Return the optimum from a guess of the active rows; None if exchanges do not end."""
        sides = sides.copy()
        for _ in range(_EXCHANGES):
            acts = sides.nonzero()[0]
            bound = np.where(sides > 0, lower, upper)[acts]
            X = factor.solve(C[acts].T).reshape(-1, len(acts))
            push = np.zeros(len(C))
            S = C[acts].dot(X)
            push[acts] = np.linalg.lstsq(S, bound - C[acts].dot(free), rcond=None)[0]
            x = free + X.dot(push[acts])
            beyond = passed(C.dot(x), lower, upper, slack)
            beyond[acts] = 0
            wrong = push * sides < -_PUSHES * np.abs(push).max(initial=0.0)
            wrong &= lower < upper
            if not beyond.any() and not wrong.any():
                open_ = float(np.abs(C[acts].dot(x) - bound).max(initial=0.0))
                if open_ > slack:
                    return None
                self._last = sides
                return Optimum(x, push, open_)
            sides[wrong] = 0
            sides = np.where(beyond != 0, beyond, sides).astype(np.int8)
        return None


class Optimum(NamedTuple):
    """Solution of a quadratic program.

    Attributes:
        x: The minimiser, shape (n,).
        multipliers: Multipliers of the rows, positive at a lower bound, shape (m,).
        residual: Largest relative violation of the optimality conditions.
    """

    x: Array
    multipliers: Array
    residual: float
