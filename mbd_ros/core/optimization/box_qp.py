"""Quadratic programs in a box, by active sets.

    min 1/2 lam' A lam + b' lam   subject to   lower <= lam <= upper

With w = A lam + b, the optimality conditions are a complementarity problem: w = 0 inside the
bounds, w >= 0 at the lower one, w <= 0 at the upper one. By Gauss's principle, the multipliers of
joint stops, dry friction and limited drives solve it (`bounded_rows`), and so do impulses of
impacts. `BoxQp` lets ProxQP find the active bounds and solves for the solution on them;
`box_moves` needs no solver.

The other functions are shared by active-set methods: A x + b = 0 in the free rows, x = bound in
the others. A is symmetric and positive semidefinite, and singular if rows are redundant; each
function says what it returns then.

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

from mbd_ros.core.optimization.qp_solvers import OtherSolver, WarmProxQp, counted
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import FIXED_BY_OTHERS, NEARLY_SINGULAR, TINY, redundant
from mbd_ros.errors import SolveError

Sides = NDArray[np.int8]  # 1 at a lower limit, -1 at an upper one, 0 between them
_SOLVED = 1.0e-9  # largest accepted `complementarity_residual`
_POLISHED = 1.0e-12  # `complementarity_residual` at which polishing stops
_POLISH_STEPS = 10
_DAMPING = 1.0e-10  # relative to a diagonal of ones
_NOTHING = 1.0e-12  # terms below this size count as zero
_DWARFS = 1.0e5
_EXCHANGES = 6
_EXACT = 1.0e-11  # complementarity residual of the right active set, relative
_EXCHANGES_OF_MANY = 12
_SOFT = 1.0e-13  # of the largest entry, a compliance that makes redundant rows solvable


class BoxQp:
    """Solver of the problem above; every solution is polished on its active set, and checked.

    A solve tries a warm start, then a cold start, then a damped A. If solutions must not depend on
    earlier ones, it never starts warm. Each try is judged by the complementarity residual, which
    is recomputed here, and never by the status of the solver.

    Args:
        n: Number of multipliers.
        backend: `proxqp`, or any solver of qpsolvers.
        rungs: Kinds of start that are tried, in this order.

    Attributes:
        statistics: Statistics of all solves.

    Raises:
        ModelError: The backend is not installed.
    """

    def __init__(
        self, n: int, backend: str = "proxqp", rungs: Sequence[str] = ("warm", "cold", "damped")
    ) -> None:
        self.statistics = Statistics()
        self._rungs = tuple(rungs)
        self._damping = _DAMPING * np.eye(n)
        self._solver = WarmProxQp(n) if backend == "proxqp" else OtherSolver(backend)

    def solve(self, A: Array, b: Array, lower: Array, upper: Array) -> Array:
        """Return the multipliers, a new array, shape (n,).

        Raises:
            SolveError: The input is not finite, lower > upper, or no try passes the check.
        """
        if not (np.isfinite(A).all() and np.isfinite(b).all() and (lower <= upper).all()):
            raise SolveError("QP refused: A or b is not finite, or lower > upper")
        self.statistics = counted(self.statistics, "solves")
        scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), TINY))
        size = max(float(np.abs(scale * b).max(initial=0.0)), TINY)
        unit = scale * size  # lam in its own unit: A gets ones on its diagonal, b at most 1
        H, scaled = scale[:, None] * A * scale, (scale * b / size, lower / unit, upper / unit)
        for rung in self._rungs:
            if rung != self._rungs[0]:
                self.statistics = counted(self.statistics, rung)
            H = H + self._damping if rung == "damped" else H
            lam = unit * self._solver.solve(H, *scaled, cold=rung != "warm")
            lam = _polished(A, b, lower, upper, np.clip(lam, lower, upper))
            residual = complementarity_residual(A, b, lower, upper, lam)
            if residual <= _SOLVED:
                return lam
        self.statistics = counted(self.statistics, "failed")
        raise SolveError(f"QP not solved: complementarity residual {residual:.1e}")


def _polished(A: Array, b: Array, lower: Array, upper: Array, lam: Array) -> Array:
    """Return the exact solution near lam by Newton's method on the natural residual.

    If the method does not converge, the best iterate is returned.

    Source: Hintermüller, Ito, Kunisch, SIAM J. Optim. 13 (2002), the primal-dual active set.
    """

    def clip(lam: Array) -> Array:
        return np.minimum(np.maximum(lam, lower), upper)

    diagonal, none = np.maximum(A.diagonal(), TINY), np.zeros(len(b))
    best, least = lam, complementarity_residual(A, b, lower, upper, lam)
    for _ in range(_POLISH_STEPS):
        if least <= _POLISHED:
            break
        stepped = clip(lam - (A.dot(lam) + b) / diagonal)
        free = (stepped > lower) & (stepped < upper)
        lam = clip(on_active_set(A, b, stepped, free))
        residual = complementarity_residual(A, b, lower, upper, lam)
        if residual > _POLISHED:  # A is singular: take the shortest step
            left = A.dot(stepped) + b
            lam = clip(stepped + on_active_set(A, left, none, free, least_norm))
            residual = complementarity_residual(A, b, lower, upper, lam)
        if residual > _SOLVED:  # contradicting rows: one of them goes to its bound
            lam = _descended(A, b, lower, upper, lam, free)
            residual = complementarity_residual(A, b, lower, upper, lam)
        if residual < least:
            best, least = lam, residual
    return best


def least_norm(A: Array, r: Array) -> Array:
    """Return the x of minimum norm that minimises |A x - r|."""
    return np.asarray(np.linalg.lstsq(A, r, rcond=redundant(len(A)))[0], dtype=np.float64)


def _descended(
    A: Array, b: Array, lower: Array, upper: Array, lam: Array, free: NDArray[np.bool_]
) -> Array:
    """Do one step of steepest descent in the free rows, to the minimum or the first bound.

    If A is singular in that direction, only a bound ends the step. For example, a joint that
    sticks at its stop has two rows on one axis, one of which must reach its bound.
    """
    direction = np.where(free, -(A.dot(lam) + b), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_bound = np.where(direction > 0.0, upper - lam, lower - lam) / direction
        to_minimum = direction.dot(direction) / max(float(direction.dot(A.dot(direction))), 0.0)
    step = min(float(to_bound[direction != 0.0].min(initial=np.inf)), float(to_minimum))
    return np.minimum(np.maximum(lam + step * direction, lower), upper) if step < np.inf else lam


def factored(A: Array, r: Array) -> Array:
    """Return the x with A x = r; for a singular A it is inexact, and the caller must check it."""
    return eigenpy.LDLT(A).solve(r).reshape(r.shape)  # eigenpy flattens one column


def exchanged(
    A: Array,
    b: Array,
    lower: Array,
    upper: Array,
    solve: Callable[[Array, Array], Array] = factored,
) -> Array | None:
    """Solve for the multipliers by a primal-dual active-set method without a QP solver.

    Args:
        A: Symmetric matrix, shape (n, n).
        b: Constant term, shape (n,).
        lower: Lower bounds of the multipliers, shape (n,).
        upper: Upper bounds of the multipliers, shape (n,).
        solve: Function that solves a system with a submatrix of A; the default assumes symmetry.

    Returns:
        The multipliers, a new array, shape (n,); None if the method does not converge in a few
        exchanges, so that a `BoxQp` is needed.
    """
    diagonal = A.diagonal()
    step = -b / diagonal
    for _ in range(_EXCHANGES):
        stepped = np.minimum(np.maximum(step, lower), upper)
        lam = on_active_set(A, b, stepped, (stepped > lower) & (stepped < upper), solve)
        clipped: Array = np.minimum(np.maximum(lam, lower), upper)
        if complementarity_residual(A, b, lower, upper, lam) <= _EXACT:
            return clipped
        step = clipped - (A.dot(clipped) + b) / diagonal
    return None


class Statistics(NamedTuple):
    """Statistics of the solves of a `BoxQp`.

    Attributes:
        solves: Number of problems that reached the solver.
        cold: Number of problems that needed a cold start.
        damped: Number of problems that needed damping.
        failed: Number of problems that were not solved.
    """

    solves: int = 0
    cold: int = 0
    damped: int = 0
    failed: int = 0


def complementarity_residual(A: Array, b: Array, lower: Array, upper: Array, lam: Array) -> float:
    """Return the largest violation of the optimality conditions, relative to terms of A lam + b.

    It is the natural residual, the length of a projected gradient step. Multipliers with terms
    much larger than b come from a singular factor, so their size does not relax the tolerance.
    """
    size_of_b = np.abs(b)
    terms = np.abs(A).dot(np.abs(lam))
    size = np.minimum(terms, _DWARFS * size_of_b.max(initial=0.0)) + size_of_b + _NOTHING
    diagonal = np.maximum(A.diagonal(), TINY)
    step = (A.dot(lam) + b) / diagonal  # not added to lam, which would lose its digits
    residual = np.minimum(np.maximum(step, lam - upper), lam - lower) * diagonal
    worst = float((np.abs(residual) / size).max())
    return worst if worst < np.inf else np.inf


def on_active_set(
    A: Array,
    b: Array,
    bound: Array,
    free: NDArray[np.bool_],
    solve: Callable[[Array, Array], Array] = factored,
) -> Array:
    """Return the x with A x + b = 0 in the free rows and x = bound in the others, shape (n,)."""
    rows = free.nonzero()[0]
    if len(rows) == len(b):
        return -solve(A, b)
    x = np.where(free, 0.0, bound)
    if len(rows):
        A_rows = A[rows]
        x[rows] = -solve(A_rows[:, rows], A_rows.dot(x) + b[rows])
    return x


def on_independent(rows: Array, bound: Array) -> tuple[Array, Array] | None:
    """Return the smallest y with rows y = bound, and multipliers; None if rows are redundant."""
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
    """Return the pseudo-inverse; singular values below `FIXED_BY_OTHERS` count as zero."""
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
    """Solve many small quadratic programs in boxes with equality constraints at once.

        min 1/2 p' H p + g' p   subject to   low <= p <= high,   A p = b

    It is a primal-dual active-set method. If it does not converge, the last step is clipped to the
    box, and the caller must check whether it reduces the cost.

    Source: M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13 (2002).

    Args:
        H: Regular matrices, shape (N, n, n).
        g: Gradients, shape (N, n).
        low: Lower bounds of p, <= 0, shape (N, n).
        high: Upper bounds of p, >= 0, shape (N, n).
        A: Matrices of equality constraints, shape (N, m, n).
        b: Right-hand sides of these, shape (N, m).
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
    H: Array, g: Array, bound: Array, fixed: NDArray[np.bool_], A: Array | None, b: Array | None
) -> tuple[Array, Array]:
    """Return the steps with some entries fixed at a bound, and the multipliers of the rows."""
    N, n = g.shape
    K, right = H, -g
    if fixed.any():
        p = np.where(fixed, bound, 0.0)
        right = np.where(fixed, p, right - (H @ p[:, :, None])[:, :, 0])
        K = np.where(fixed[:, :, None] | fixed[:, None, :], 0.0, H)
        K[:, range(n), range(n)] += fixed
    if A is None or b is None:
        p = np.array(np.linalg.solve(K, right[:, :, None])[:, :, 0], dtype=np.float64)
        return p, np.zeros((N, 0))
    m = A.shape[1]
    kkt = np.zeros((N, n + m, n + m))
    free = A
    if fixed.any():
        b = b - (A @ p[:, :, None])[:, :, 0]
        free = np.where(fixed[:, None, :], 0.0, A)
    kkt[:, :n, :n], kkt[:, n:, :n], kkt[:, :n, n:] = K, free, free.transpose(0, 2, 1)
    soft = _SOFT * np.abs(A).max(axis=(1, 2)) ** 2 / np.abs(H).max(axis=(1, 2))
    kkt[:, range(n, n + m), range(n, n + m)] = -soft[:, None]
    right = np.concatenate((right, b), axis=1)[:, :, None]
    solution = np.array(np.linalg.solve(kkt, right)[:, :, 0], dtype=np.float64)
    return solution[:, :n], solution[:, n:]


class Moves(NamedTuple):
    """Solutions of N quadratic programs.

    Attributes:
        p: Steps, shape (N, n).
        nu: Multipliers of the rows, H p + g + A' nu = force of bounds, shape (N, m).
        force: Multipliers of the bounds, > 0 at a lower bound, shape (N, n).
    """

    p: Array
    nu: Array
    force: Array


def passed(values: Array, lower: Array, upper: Array, slack: float = 0.0) -> Sides:
    """Return the limits that values exceed by more than a slack, negative for limits nearby."""
    below, above = values < lower - slack, values > upper + slack
    return below.astype(np.int8) - (above & ~below)
