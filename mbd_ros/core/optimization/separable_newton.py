"""Newton's method on the conditions of the optimum of a separable program.

    f_i'(x_i) = s_i between the bounds, >= at the lower one, <= at the upper one;   A x = b

with s = A' lam. Where the f are strictly convex x is a function of s, and what is left are
equations in lam: Newton's method on these exchanges the bounds that act by itself. Sources:
M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13 (2002), on the exchange; J. Nocedal,
S. Wright, Numerical Optimization, 2006, ch. 12, on the conditions.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.separable_cost import SeparableCost
from mbd_ros.core.optimization.separable_interior import split_at_zero
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import NEARLY_SINGULAR, SINGULAR, TINY

_EXACT = 1.0e-12  # `optimality_residual` below which a further step gains nothing
_RIDGE = 1.0e-15  # beside the largest entry of a diagonal
_AT_BOUND = 1.0e-7  # of the distance of bounds, at most 1: near enough for a vertex to try
_PRESSED = 1.0e-7  # of the largest slope: a multiplier that holds an unknown at its bound
_ASCENTS = 40
_FAR = 1.0e-6  # a row that lacks more leaves nothing to judge
_FLAT = 1.0e-14  # of the largest curvature: less counts as this
_HALVINGS = 30


class Problem(NamedTuple):
    """min sum f_i(x_i) subject to A x = b, lower <= x <= upper.

    Attributes:
        cost: The f.
        A: Shape (m, n), rows of about equal size.
        b: Shape (m,).
        lower: Shape (n,), -inf without a bound.
        upper: Same, >= lower.
    """

    cost: SeparableCost
    A: Array
    b: Array
    lower: Array
    upper: Array

    def kept(self, x: Array) -> Array:
        """The nearest within the bounds."""
        near: Array = np.minimum(np.maximum(x, self.lower), self.upper)
        return near

    def residual(self, x: Array, lam: Array) -> float:
        """Largest violation of the conditions of the optimum; a bound counts by any distance.

        Of a row relative to its terms, of an unknown relative to the largest slope and weight of
        the cost.
        """
        cost, A, b, lower, upper = self
        if not ((x >= lower) & (x <= upper)).all():
            return np.inf
        slope = cost.slope(x)
        left = slope - A.T.dot(lam)
        wrong = np.abs(left)
        if cost.exponent == 1.0:
            wrong = np.maximum(wrong - cost.kink(x), 0.0)
        wrong[((x <= lower) & (left > 0.0)) | ((x >= upper) & (left < 0.0))] = 0.0
        size = np.maximum(np.abs(slope), cost.weight + cost.stiffness).max(initial=TINY)
        worst = self.missing(x, b - A.dot(x), np.abs(A))
        worst = max(worst, float(wrong.max(initial=0.0) / size))
        return worst if worst < np.inf else np.inf

    def missing(self, x: Array, left: Array, sizes: Array) -> float:
        """Largest violation of a row, relative to its terms.

        Args:
            x: Shape (n,).
            left: b - A x.
            sizes: Of the entries of A.
        """
        terms = sizes.dot(np.abs(x)) + np.abs(self.b) + TINY
        return float((np.abs(left) / terms).max(initial=0.0))

    def movable(self, x: Array, lam: Array) -> tuple[int, ...]:
        """Unknowns that other optima have otherwise; none where the cost bends everywhere.

        An unknown stays where it is pressed against a bound or a kink. The others move along what
        keeps the rows.
        """
        cost, A, _, lower, upper = self
        is_bent = (cost.stiffness > 0.0) | ((cost.weight > 0.0) & (cost.exponent > 1.0))
        if is_bent.all():
            return ()
        slope = cost.slope(x)
        left = np.abs(slope - A.T.dot(lam))
        at_end = (x <= lower) | (x >= upper)
        size = float(np.maximum(np.abs(slope), cost.weight).max(initial=TINY))
        pressed = at_end & (left > _PRESSED * size)
        pressed |= (cost.kink(x) > 0.0) & (cost.kink(x) - left > _PRESSED * size)
        some = (~is_bent & ~pressed).nonzero()[0]
        if not len(some):
            return ()
        _, s, Vt = np.linalg.svd(A[:, some])
        rank = int(np.count_nonzero(s > SINGULAR * s.max(initial=TINY)))
        moves = np.abs(Vt[rank:]).max(axis=0, initial=0.0) > SINGULAR
        return tuple(some[moves].tolist())


class Found(NamedTuple):
    """An x with its lam, and how far they are from the conditions.

    Attributes:
        x: Shape (n,).
        lam: Shape (m,).
        residual: See `Problem.residual`.
    """

    x: Array
    lam: Array
    residual: float


def refined(problem: Problem, x: Array, lam: Array, most: int) -> Found:
    """The best on the way of Newton's method from x and lam.

    Args:
        problem: The problem.
        x: Start, shape (n,).
        lam: Start, shape (m,).
        most: Steps.
    """
    cost, A, b, lower, upper = problem
    if cost.exponent == 1.0 and not (cost.stiffness > 0.0).all():
        return _vertex(problem, x, lam)
    split = split_at_zero(cost, lower, upper)
    x, s = problem.kept(x), A.T.dot(lam)
    best = Found(x, lam, np.inf)
    for _ in range(most):
        if len(split):
            x = x.copy()
            x[split] = cost.some(split).at_slope(s[split])
        give = 1.0 / np.maximum(cost.curvature(x), TINY)
        y = x + give * (s - cost.slope(x))
        x = problem.kept(y)
        lam = lam + _solved((A * (give * (x == y))).dot(A.T), b - A.dot(x))
        s, before = A.T.dot(lam), s
        x = problem.kept(y + give * (s - before))
        residual = problem.residual(x, lam)
        if residual < best.residual:
            best = Found(x, lam, residual)
        if residual <= _EXACT:
            break
    return best


def ascended(problem: Problem, lam: Array) -> Found:
    """The best on the way of Newton's method on A x(lam) = b, each step as far as that helps.

    For squares, and for powers beyond 2 without tracking, whose x(s) has a closed form. The slope
    of the dual is b - A x(lam). It is concave, so that short enough steps rise.

    Args:
        problem: The problem.
        lam: Start, shape (m,).
    """
    cost, A, sizes = problem.cost, problem.A, np.abs(problem.A)
    x_at = _answers(problem)
    x, free, left = x_at(lam)
    best = Found(x, lam, np.inf)
    for _ in range(_ASCENTS):
        if problem.missing(x, left, sizes) <= _FAR:
            residual = problem.residual(x, lam)
            if residual < best.residual:
                best = Found(x, lam, residual)
            if residual <= _EXACT:
                break
        stiff = cost.curvature(x)
        give = free / np.maximum(stiff, _FLAT * stiff[free].max(initial=TINY))
        step = _solved((A * give).dot(A.T), left)
        uphill = left.dot(step)
        for _ in range(_HALVINGS):
            x, free, left = x_at(lam + step)
            if left.dot(step) >= -0.5 * uphill:
                break
            step, uphill = step / 2.0, uphill / 2.0
        lam = lam + step
    return best


def multipliers_at(problem: Problem, x: Array) -> Array:
    """The lam that explain an x best, of curved unknowns between their bounds."""
    free = (x > problem.lower) & (x < problem.upper)
    flat = np.maximum(problem.cost.curvature(x)[free], TINY) ** -0.5
    return _least((problem.A[:, free] * flat).T, flat * problem.cost.slope(x)[free])


def _answers(problem: Problem) -> Callable[[Array], tuple[Array, NDArray[np.bool_], Array]]:
    """From lam to x(lam), which of it lies between the bounds, and b - A x."""
    cost, A, b, lower, upper = problem
    unbounded = cost.inverse_slope()

    def at(lam: Array) -> tuple[Array, NDArray[np.bool_], Array]:
        y = unbounded(A.T.dot(lam))
        x = np.minimum(np.maximum(y, lower), upper)
        return x, x == y, b - A.dot(x)

    return at


def _solved(M: Array, r: Array) -> Array:
    M.flat[:: len(r) + 1] += _RIDGE * max(float(M.diagonal().max(initial=0.0)), TINY)
    try:
        return np.asarray(np.linalg.solve(M, r), dtype=np.float64)
    except np.linalg.LinAlgError:
        return _least(M, r)


def _least(rows: Array, r: Array) -> Array:
    return np.asarray(np.linalg.lstsq(rows, r, rcond=NEARLY_SINGULAR)[0], dtype=np.float64)


def _vertex(problem: Problem, x: Array, lam: Array) -> Found:
    """Of a linear program: the nearest on the rows where what is at a bound or kink stays."""
    cost, A, b, lower, upper = problem
    near = _AT_BOUND * np.minimum(upper - lower, 1.0)
    x = np.where(x <= lower + near, lower, np.where(x >= upper - near, upper, x))
    x = np.where((np.abs(x) <= near) & (lower < 0.0) & (upper > 0.0), 0.0, x)
    free = (x > lower) & (x < upper) & (cost.kink(x) == 0.0)
    onto = np.asarray(np.linalg.pinv(A[:, free], rcond=SINGULAR), dtype=np.float64)
    for _ in range(2):  # the second time for what rounding left
        x[free] += onto.dot(b - A.dot(x))
    x = problem.kept(x)
    lam = lam + onto.T.dot((cost.slope(x) - A.T.dot(lam))[free])
    return Found(x, lam, problem.residual(x, lam))
