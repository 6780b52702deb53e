"""Quadratic programs in a box, by active sets.

    min 1/2 lam' A lam + b' lam   subject to   lower <= lam <= upper

With w = A lam + b the optimum is a complementarity: w = 0 inside the bounds, w >= 0 at the lower
one, w <= 0 at the upper one. Gauss's principle asks it of the multipliers of joint stops, dry
friction and limited drives (`bounded_rows`), impacts that of impulses. `BoxQp` asks ProxQP which
bounds are active and solves for the answer on them; `box_moves` does without a solver.

The functions at the end are what active-set methods share: A x + b = 0 in the free rows, x = bound
in the others. A is symmetric and positive semidefinite. It is singular where rows depend on one
another; each solve says what it gives then.

Sources: P. Lötstedt, SIAM J. Sci. Stat. Comput. 5 (1984); M. Hintermüller, K. Ito, K. Kunisch,
SIAM J. Optim. 13 (2002), on the exchange of rows; J. Nocedal, S. Wright, Numerical Optimization,
2006, ch. 16; G. H. Golub, C. F. Van Loan, Matrix Computations, 2013, sec. 5.4 and 5.5, on ranks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.qp_solvers import KeptProxQp, OtherSolver, counted
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import FIXED_BY_OTHERS, NEARLY_SINGULAR, TINY, redundant
from mbd_ros.errors import SolveError

Sides = NDArray[np.int8]  # 1 at a lower limit, -1 at an upper one, 0 between them
_SOLVED = 1.0e-9  # `complementarity_residual` that is accepted
_POLISHED = 1.0e-12  # the same, below which a further step gains nothing
_POLISH_STEPS = 10
_DAMPING = 1.0e-10  # beside a diagonal of ones
_NOTHING = 1.0e-12  # terms of that size are none
_DWARFS = 1.0e5
_EXCHANGES = 6
_EXACT = 1.0e-11  # complementarity residual of the right active set, relative
_EXCHANGES_OF_MANY = 12
_SOFT = 1.0e-13  # of the largest entry: what keeps dependent rows solvable


class BoxQp:
    """Solves the problem above; every answer is polished by an active set, and checked.

    A solve starts warm, then from nothing, then with a damped A, and fails after that; where an
    answer must not depend on earlier ones, it never starts warm. Each try is judged by the
    complementarity residual recomputed here, never by the solver's status.

    Args:
        n: Number of multipliers.
        backend: `proxqp`, kept between calls, or any solver of qpsolvers, started anew.
        rungs: How solves start, one after the other.

    Attributes:
        statistics: Counts so far.

    Raises:
        ModelError: The backend is not installed.
    """

    def __init__(
        self, n: int, backend: str = "proxqp", rungs: Sequence[str] = ("warm", "cold", "damped")
    ) -> None:
        self.statistics = Statistics()
        self._rungs = tuple(rungs)
        self._damping = _DAMPING * np.eye(n)
        self._solver = KeptProxQp(n) if backend == "proxqp" else OtherSolver(backend)

    def solve(self, A: Array, b: Array, lower: Array, upper: Array) -> Array:
        """Multipliers, shape (n,), fresh.

        Raises:
            SolveError: Input that is not finite, lower > upper, or no rung of the ladder gives an
                answer that passes the check.
        """
        if not (np.isfinite(A).all() and np.isfinite(b).all() and (lower <= upper).all()):
            raise SolveError("QP refused: A or b is not finite, or lower > upper")
        self.statistics = counted(self.statistics, "solves")
        scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), TINY))
        size = max(float(np.abs(scale * b).max(initial=0.0)), TINY)
        unit = scale * size  # lam in its own unit: A gets ones on its diagonal, b at most 1
        H, rest = scale[:, None] * A * scale, (scale * b / size, lower / unit, upper / unit)
        for rung in self._rungs:
            if rung != self._rungs[0]:
                self.statistics = counted(self.statistics, rung)
            H = H + self._damping if rung == "damped" else H
            lam = unit * self._solver.solve(H, *rest, cold=rung != "warm")
            lam = _polished(A, b, lower, upper, np.clip(lam, lower, upper))
            residual = complementarity_residual(A, b, lower, upper, lam)
            if residual <= _SOLVED:
                return lam
        self.statistics = counted(self.statistics, "failed")
        raise SolveError(f"QP not solved: complementarity residual {residual:.1e}")


def _polished(A: Array, b: Array, lower: Array, upper: Array, lam: Array) -> Array:
    """The exact solution near lam, by Newton's method on the natural residual; else the best.

    Source: Hintermüller, Ito, Kunisch, SIAM J. Optim. 13 (2002), the primal-dual active set.
    """

    def kept(lam: Array) -> Array:
        return np.minimum(np.maximum(lam, lower), upper)

    diagonal, none = np.maximum(A.diagonal(), TINY), np.zeros(len(b))
    best, least = lam, complementarity_residual(A, b, lower, upper, lam)
    for _ in range(_POLISH_STEPS):
        if least <= _POLISHED:
            break
        stepped = kept(lam - (A.dot(lam) + b) / diagonal)
        free = (stepped > lower) & (stepped < upper)
        lam = kept(on_active_set(A, b, stepped, free))
        residual = complementarity_residual(A, b, lower, upper, lam)
        if residual > _POLISHED:  # singular: the shortest way from where it is
            left = A.dot(stepped) + b
            lam = kept(stepped + on_active_set(A, left, none, free, least_norm))
            residual = complementarity_residual(A, b, lower, upper, lam)
        if residual > _SOLVED:  # rows that ask for different things: one of them gives way
            lam = _descended(A, b, lower, upper, lam, free)
            residual = complementarity_residual(A, b, lower, upper, lam)
        if residual < least:
            best, least = lam, residual
    return best


def least_norm(A: Array, r: Array) -> Array:
    """The x of smallest norm with A x nearest to r."""
    return np.asarray(np.linalg.lstsq(A, r, rcond=redundant(len(A)))[0], dtype=np.float64)


def _descended(
    A: Array, b: Array, lower: Array, upper: Array, lam: Array, free: NDArray[np.bool_]
) -> Array:
    """Along the gradient of the free rows, to the least value or to the first bound.

    Where A is singular in that direction, only a bound ends it: a joint that sticks at its stop
    has two rows on one axis, of which one is to reach its bound.
    """
    way = np.where(free, -(A.dot(lam) + b), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(way > 0.0, upper - lam, lower - lam) / way
        least = way.dot(way) / max(float(way.dot(A.dot(way))), 0.0)
    step = min(float(room[way != 0.0].min(initial=np.inf)), float(least))
    return np.minimum(np.maximum(lam + step * way, lower), upper) if step < np.inf else lam


def factored(A: Array, r: Array) -> Array:
    """The x with A x = r; where A is singular, what its factor leaves, for the caller to judge."""
    return eigenpy.LDLT(A).solve(r).reshape(r.shape)  # eigenpy flattens one column


def exchanged(
    A: Array,
    b: Array,
    lower: Array,
    upper: Array,
    solve: Callable[[Array, Array], Array] = factored,
) -> Array | None:
    """The multipliers by exchange of rows, from those on that each row by itself asks for.

    Args:
        A: Shape (n, n).
        b: Shape (n,).
        lower: Smallest multipliers, shape (n,).
        upper: Largest multipliers, shape (n,).
        solve: What solves with a part of A; the default takes it to be symmetric.

    Returns:
        Shape (n,), fresh; None where that does not end soon, and a `BoxQp` has to serve.
    """
    diagonal = A.diagonal()
    step = -b / diagonal
    for _ in range(_EXCHANGES):
        stepped = np.minimum(np.maximum(step, lower), upper)
        lam = on_active_set(A, b, stepped, (stepped > lower) & (stepped < upper), solve)
        kept: Array = np.minimum(np.maximum(lam, lower), upper)
        if complementarity_residual(A, b, lower, upper, lam) <= _EXACT:
            return kept
        step = kept - (A.dot(kept) + b) / diagonal
    return None


class Statistics(NamedTuple):
    """How the solves of a `BoxQp` went.

    Attributes:
        solves: Problems that reached the solver.
        cold: Those that needed a restart from nothing.
        damped: Those that needed damping.
        failed: Those that none of it solved.
    """

    solves: int = 0
    cold: int = 0
    damped: int = 0
    failed: int = 0


def complementarity_residual(A: Array, b: Array, lower: Array, upper: Array, lam: Array) -> float:
    """Largest violation of the optimality conditions, relative to the terms in A lam + b.

    It is the natural residual: how far a gradient step, kept in the bounds, moves. Multipliers
    whose terms dwarf b come from a singular factor, and do not excuse what they leave.
    """
    given = np.abs(b)
    terms = np.abs(A).dot(np.abs(lam))
    size = np.minimum(terms, _DWARFS * given.max(initial=0.0)) + given + _NOTHING
    diagonal = np.maximum(A.diagonal(), TINY)
    step = (A.dot(lam) + b) / diagonal  # kept apart from lam, which might swallow it
    moved = np.minimum(np.maximum(step, lam - upper), lam - lower) * diagonal
    worst = float((np.abs(moved) / size).max())
    return worst if worst < np.inf else np.inf


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


def box_moves(
    H: Array, g: Array, low: Array, high: Array, A: Array | None = None, b: Array | None = None
) -> Moves:
    """Solve many small quadratic programs at once: moves in boxes, with rows that are kept.

        min 1/2 p' H p + g' p   subject to   low <= p <= high,   A p = b

    Bounds are exchanged all at once, as a primal-dual active set does. Where that does not settle,
    the last move is cut to the box: the caller judges a move by what it gains. Source: M.
    Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13 (2002).

    Args:
        H: Regular matrices, shape (N, n, n).
        g: Slopes, shape (N, n).
        low: Lower bounds of moves, <= 0, shape (N, n).
        high: Upper bounds, >= 0, shape (N, n).
        A: Rows, shape (N, m, n).
        b: What they ask for, shape (N, m).
    """
    at_low, at_high = (np.zeros(g.shape, dtype=np.bool_) for _ in range(2))
    for _ in range(_EXCHANGES_OF_MANY):
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


def passed(values: Array, lower: Array, upper: Array, slack: float = 0.0) -> Sides:
    """The limits that values pass by more than a slack; a negative slack tells who is near."""
    below, above = values < lower - slack, values > upper + slack
    return below.astype(np.int8) - (above & ~below)
