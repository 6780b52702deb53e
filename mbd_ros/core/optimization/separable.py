"""Separable programs: how unknowns that outnumber equations share what these ask for.

    min sum f_i(x_i)   subject to   A x = b,   lower <= x <= upper

Static optimisation of muscles asks it, one frame after the other. The conditions of the optimum
are

    f_i'(x_i) = s_i between the bounds, >= at the lower one, <= at the upper one;   s = A' lam

Where the f are strictly convex x is a function of s, and what is left are equations in lam:
Newton's method on these exchanges the bounds that act by itself (`ascended`, `refined`).
`interior_start` gives it a start from nothing.

Sources: M. Hintermüller, K. Ito, K. Kunisch, SIAM J. Optim. 13 (2002), on the exchange; J.
Nocedal, S. Wright, Numerical Optimization, 2006, ch. 12, on the conditions, and ch. 19; S.
Mehrotra, SIAM J. Optim. 2 (1992); S. Wright, Primal-Dual Interior-Point Methods, 1997, ch. 10, on
interior points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.qp_solvers import counted
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import NEARLY_SINGULAR, SINGULAR, TINY
from mbd_ros.errors import SolveError

Indices = NDArray[np.intp]
_STEPS = 80  # of the interior point
_TO_BOUND = 0.995  # of the way to the nearest bound
_SMALL = 1.0e-13  # residuals that end it, of the terms
_RIDGE = 1.0e-14  # beside a diagonal of ones
_EXACT = 1.0e-12  # `Problem.residual` below which a further step gains nothing
_RIDGE_OF_LAM = 1.0e-15  # of the largest entry of a diagonal: keeps the equations of lam solvable
_AT_BOUND = 1.0e-7  # of the distance of bounds, at most 1: near enough for a vertex to try
_PRESSED = 1.0e-7  # of the largest slope: a multiplier that holds an unknown at its bound
_ASCENTS = 40  # steps in lam
_FAR = 1.0e-6  # a row that lacks more leaves nothing to judge
_FLAT = 1.0e-14  # of the largest curvature: less counts as this
_HALVINGS = 30  # of such a step
_SOLVED = 5.0e-9  # residual that is accepted
_EXCHANGES = 12  # steps from a warm start where costs are no squares
_REFINING = 30  # steps from an interior start
_GENTLE = 3.0  # exponent up to which the interior start is near enough
_RISE = 1.3  # of the exponent from one start to the next
_NEAR = 1.0e-6  # residual of a start for the next exponent
_PRICES = 1.0e4, 1.0e6  # of what a row lacks, in the largest price of an unknown
_STAYS = 0.5  # share of what lacks that stays at the higher price
_EMPTY = 1.0e-12  # of the largest row: what rounding leaves of none
_SHORT = 1.0e-7  # of the largest terms of a row: what lacks where no x fulfils all


class SeparableProgram:
    """Solves programs of one size, each from the answer to the last one.

    A solve starts warm, then by an interior point; where no x fulfils the rows, what they lack
    is a further unknown with a high price. Every answer is judged by its residual, recomputed.

    Args:
        n: Number of unknowns.
        rows: Number of equations.

    Attributes:
        statistics: Counts so far.
    """

    def __init__(self, n: int, rows: int) -> None:
        self.statistics = Statistics()
        self._x = np.zeros(n)
        self._lam = np.zeros(rows)

    def forget(self) -> None:
        """Start the next solve as the first one started."""
        self._x, self._lam = np.zeros(len(self._x)), np.zeros(len(self._lam))

    def solve(
        self, cost: SeparableCost, A: Array, b: Array, lower: Array, upper: Array
    ) -> Optimum:
        """The optimum, fresh arrays.

        Args:
            A: Shape (m, n).
            b: Shape (m,).
            lower: Shape (n,), -inf without a bound.
            upper: Same, >= lower.

        Raises:
            SolveError: Input that is not finite, lower > upper, or no answer passes the check.
        """
        if not (np.isfinite(A).all() and np.isfinite(b).all() and (lower <= upper).all()):
            raise SolveError("program refused: A or b is not finite, or lower > upper")
        self.statistics = counted(self.statistics, "solves")
        size = np.abs(A).max(axis=1, initial=0.0)
        is_empty = size <= _EMPTY * size.max(initial=0.0)
        scale = np.where(is_empty, 0.0, 1.0 / np.where(is_empty, 1.0, size))
        problem = Problem(cost, scale[:, None] * A, scale * b, lower, upper)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            solution = self._feasible(problem)
            is_feasible = solution is not None and not b[is_empty].any()  # nothing fills them
            if solution is None:
                solution = _least_lacking(problem)
        if not is_feasible:
            self.statistics = counted(self.statistics, "short")
        lacking = b - A.dot(solution.x)
        movable = problem.movable(solution.x, solution.lam)
        lam = scale * solution.lam
        return Optimum(solution.x.copy(), lam, lacking, solution.residual, is_feasible, movable)

    def _feasible(self, problem: Problem) -> Found | None:
        if problem.cost.is_quadratic:
            solution = ascended(problem, self._lam)
        else:
            solution = refined(problem, self._x, self._lam, _EXCHANGES)
        if solution.residual > _SOLVED:
            self.statistics = counted(self.statistics, "cold")
            solution = _from_inside(problem)
        if solution.residual > _SOLVED:
            return None
        self._x, self._lam = solution.x, solution.lam
        return solution


class Statistics(NamedTuple):
    """How the solves went.

    Attributes:
        solves: Problems in all.
        cold: Those that needed a start from nothing.
        short: Those without any x that fulfils the rows.
    """

    solves: int = 0
    cold: int = 0
    short: int = 0


def _least_lacking(problem: Problem) -> Found:
    """The x that lacks least, nearly, of these that with the least squares.

    A unit that a row lacks costs much more than any other. What lacks does not get less when it
    costs still more; else the problem can be met, and was not solved.
    """
    cheap, dear = (_priced(problem, price) for price in _PRICES)
    if dear.residual > _SOLVED:
        dear = cheap
    lacks = [float(np.abs(problem.b - problem.A.dot(f.x)).max()) for f in (cheap, dear)]
    terms = np.abs(problem.A).dot(np.abs(dear.x)) + np.abs(problem.b)
    is_short = lacks[1] > _STAYS * lacks[0] and lacks[1] > _SHORT * float(terms.max())
    if max(dear.residual, cheap.residual) > _SOLVED or not is_short:
        raise SolveError(f"program not solved: residual {dear.residual:.1e}")
    return dear


def _priced(problem: Problem, price: float) -> Found:
    """The x where what a row lacks is a further unknown, at a price per square."""
    cost, A, b, lower, upper = problem
    m, n = A.shape
    none, free = np.zeros(m), np.full(m, np.inf)
    each = np.full(m, price * float((cost.weight + cost.stiffness).max()))
    wide = cost._replace(exponent=2.0).joined(SeparableCost(2.0, none, none, each, none))
    rows, low, high = np.hstack((A, np.eye(m))), np.append(lower, -free), np.append(upper, free)
    found = _from_inside(Problem(wide, rows, b, low, high))
    return found._replace(x=found.x[:n])


def _from_inside(problem: Problem) -> Found:
    """From nothing; unknowns whose bounds meet stay aside, high exponents are risen to."""
    cost, A, b, lower, upper = problem
    x, is_open = lower.copy(), upper > lower
    some, rest = is_open.nonzero()[0], b - A[:, ~is_open].dot(lower[~is_open])
    first = cost._replace(exponent=min(cost.exponent, _GENTLE))
    x[some], lam = interior_start(first.some(some), A[:, some], rest, lower[some], upper[some])
    solution = refined(problem._replace(cost=first), x, lam, _REFINING)
    while first.exponent < cost.exponent and solution.residual <= _NEAR:
        first = cost._replace(exponent=min(cost.exponent, _RISE * first.exponent))
        harder = problem._replace(cost=first)
        solution = ascended(harder, multipliers_at(harder, solution.x))
    is_done = first.exponent == cost.exponent
    return solution if is_done else solution._replace(residual=np.inf)


class Optimum(NamedTuple):
    """The answer.

    Attributes:
        x: Within the bounds, shape (n,).
        multipliers: What a further unit of b costs, shape (m,).
        lacking: b - A x, which is rounding where `is_feasible`, shape (m,).
        residual: `Problem.residual` of the answer.
        is_feasible: Whether an x fulfils the rows; else this one lacks least, nearly.
        movable: Unknowns that other optima have otherwise; none where the optimum is unique.
    """

    x: Array
    multipliers: Array
    lacking: Array
    residual: float
    is_feasible: bool
    movable: tuple[int, ...] = ()


class Problem(NamedTuple):
    """min sum f_i(x_i) subject to A x = b, lower <= x <= upper.

    Attributes:
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

    def clip(self, x: Array) -> Array:
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
        x: Start, shape (n,).
        lam: Start, shape (m,).
    """
    cost, A, b, lower, upper = problem
    if cost.exponent == 1.0 and not (cost.stiffness > 0.0).all():
        return _vertex(problem, x, lam)
    split = split_at_zero(cost, lower, upper)
    x, s = problem.clip(x), A.T.dot(lam)
    best = Found(x, lam, np.inf)
    for _ in range(most):
        if len(split):
            x = x.copy()
            x[split] = cost.some(split).at_slope(s[split])
        give = 1.0 / np.maximum(cost.curvature(x), TINY)
        y = x + give * (s - cost.slope(x))
        x = problem.clip(y)
        lam = lam + _solved((A * (give * (x == y))).dot(A.T), b - A.dot(x))
        s, before = A.T.dot(lam), s
        x = problem.clip(y + give * (s - before))
        residual = problem.residual(x, lam)
        if residual < best.residual:
            best = Found(x, lam, residual)
        if residual <= _EXACT:
            break
    return best


def _vertex(problem: Problem, x: Array, lam: Array) -> Found:
    """Return the nearest point on the rows for a linear cost; unknowns at a bound or kink stay."""
    cost, A, b, lower, upper = problem
    near = _AT_BOUND * np.minimum(upper - lower, 1.0)
    x = np.where(x <= lower + near, lower, np.where(x >= upper - near, upper, x))
    x = np.where((np.abs(x) <= near) & (lower < 0.0) & (upper > 0.0), 0.0, x)
    free = (x > lower) & (x < upper) & (cost.kink(x) == 0.0)
    onto = np.asarray(np.linalg.pinv(A[:, free], rcond=SINGULAR), dtype=np.float64)
    for _ in range(2):  # the second time for what rounding left
        x[free] += onto.dot(b - A.dot(x))
    x = problem.clip(x)
    lam = lam + onto.T.dot((cost.slope(x) - A.T.dot(lam))[free])
    return Found(x, lam, problem.residual(x, lam))


def _solved(M: Array, r: Array) -> Array:
    M.flat[:: len(r) + 1] += _RIDGE_OF_LAM * max(float(M.diagonal().max(initial=0.0)), TINY)
    try:
        return np.asarray(np.linalg.solve(M, r), dtype=np.float64)
    except np.linalg.LinAlgError:
        return _least(M, r)


def _least(rows: Array, r: Array) -> Array:
    return np.asarray(np.linalg.lstsq(rows, r, rcond=NEARLY_SINGULAR)[0], dtype=np.float64)


def ascended(problem: Problem, lam: Array) -> Found:
    """The best on the way of Newton's method on A x(lam) = b, each step as far as that helps.

    For squares, and for powers beyond 2 without tracking, whose x(s) has a closed form. The slope
    of the dual is b - A x(lam). It is concave, so that short enough steps rise.

    Args:
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


def _answers(problem: Problem) -> Callable[[Array], tuple[Array, NDArray[np.bool_], Array]]:
    """From lam to x(lam), which of it lies between the bounds, and b - A x."""
    cost, A, b, lower, upper = problem
    unbounded = cost.inverse_slope()

    def at(lam: Array) -> tuple[Array, NDArray[np.bool_], Array]:
        y = unbounded(A.T.dot(lam))
        x = np.minimum(np.maximum(y, lower), upper)
        return x, x == y, b - A.dot(x)

    return at


def multipliers_at(problem: Problem, x: Array) -> Array:
    """The lam that explain an x best, of curved unknowns between their bounds."""
    free = (x > problem.lower) & (x < problem.upper)
    flat = np.maximum(problem.cost.curvature(x)[free], TINY) ** -0.5
    return _least((problem.A[:, free] * flat).T, flat * problem.cost.slope(x)[free])


def interior_start(
    cost: SeparableCost, A: Array, b: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """An x near the optimum, from nothing, and its multipliers.

    Primal-dual interior point: the conditions of the optimum with z (x - bound) = mu in place of
    0, by Newton's method while mu goes to 0. An unknown with both signs whose f is no smooth
    function at 0 is the difference of two that are not negative. Nothing is promised where there
    is no optimum.

    Args:
        A: Shape (m, n), rows of about equal size.
        b: Shape (m,).
        lower: Shape (n,), -inf without a bound.
        upper: Same, > lower.

    Returns:
        x and the lam of A x = b with f' = A' lam between the bounds.
    """
    n, split = A.shape[1], split_at_zero(cost, lower, upper)
    low, high = lower.copy(), upper
    if len(split):
        cost = cost.joined(cost.some(split, -1.0))
        low[split], none = 0.0, np.zeros(len(split))
        low, high = np.concatenate((low, none)), np.concatenate((upper, -lower[split]))
        A = np.concatenate((A, -A[:, split]), axis=1)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        x, lam = _followed(cost, A, b, low, high)
    found = x[:n]
    found[split] -= x[n:]
    return found, lam


def _followed(
    cost: SeparableCost, A: Array, b: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """The x and lam at the end of the path on which mu goes to 0."""
    is_low, is_high = np.isfinite(lower), np.isfinite(upper)
    bounds = max(int(is_low.sum() + is_high.sum()), 1)
    x, lam = _middle(lower, upper), np.zeros(len(b))
    size = float(np.abs(cost.slope(x)).max(initial=TINY))
    z, y = size * is_low, size * is_high
    for _ in range(_STEPS):
        below, above = np.where(is_low, x - lower, 1.0), np.where(is_high, upper - x, 1.0)
        slope = cost.slope(x)
        dual, primal = A.T.dot(lam) - slope + z - y, b - A.dot(x)
        mu = float(z.dot(below) + y.dot(above)) / bounds
        if _is_small(dual, slope, primal, b, mu):
            break
        give = 1.0 / np.maximum(cost.curvature(x) + z / below + y / above, TINY)
        linear = _Linear(A, _inverse(A, give), give, dual, primal, below, above)
        dx, _, dz, dy = linear.step(z, y, -z * below, -y * above)
        t = _length(((x - lower, dx), (upper - x, -dx), (z, dz), (y, dy)))
        after = (z + t * dz).dot(below + t * dx * is_low)
        after += (y + t * dy).dot(above - t * dx * is_high)
        centre = mu * min(max(after / (bounds * max(mu, TINY)), 0.0), 1.0) ** 3
        to_z = np.where(is_low, centre - z * below - dx * dz, 0.0)
        to_y = np.where(is_high, centre - y * above + dx * dy, 0.0)
        dx, dlam, dz, dy = linear.step(z, y, to_z, to_y)
        if not np.isfinite(dx).all():
            break
        t = _length(((x - lower, dx), (upper - x, -dx), (z, dz), (y, dy)))
        x, lam, z, y = x + t * dx, lam + t * dlam, z + t * dz, y + t * dy
    return x, lam


def _middle(lower: Array, upper: Array) -> Array:
    """Between the bounds; away from zero, where powers have no curvature, without any."""
    low, high = np.isfinite(lower), np.isfinite(upper)
    return np.where(
        low & high,
        (np.where(low, lower, 0.0) + np.where(high, upper, 0.0)) / 2.0,
        np.where(low, lower + 1.0, np.where(high, upper - 1.0, 0.1)),
    )


def _is_small(dual: Array, slope: Array, primal: Array, b: Array, mu: float) -> bool:
    size = 1.0 + float(np.abs(slope).max(initial=0.0))
    most = 1.0 + float(np.abs(b).max(initial=0.0))
    return bool(
        np.abs(dual).max(initial=0.0) <= _SMALL * size
        and np.abs(primal).max(initial=0.0) <= _SMALL * most
        and mu <= _SMALL * size
    )


class _Linear(NamedTuple):
    """The conditions, linear about a point."""

    A: Array
    inverse: Array  # of A give A'
    give: Array
    dual: Array
    primal: Array
    below: Array
    above: Array

    def step(self, z: Array, y: Array, to_z: Array, to_y: Array) -> tuple[Array, ...]:
        """Steps of x, lam, z, y by which z (x - lower) changes by to_z, y (upper - x) by to_y."""
        rest = self.dual + to_z / self.below - to_y / self.above
        dlam = self.inverse.dot(self.primal - self.A.dot(self.give * rest))
        dx = self.give * (rest + self.A.T.dot(dlam))
        return dx, dlam, (to_z - z * dx) / self.below, (to_y + y * dx) / self.above


def _inverse(A: Array, give: Array) -> Array:
    """Inverse of A give A', by way of ones on its diagonal: in the end its rows differ a lot."""
    M = (A * give).dot(A.T)
    diagonal = M.diagonal()
    scale = np.where(diagonal > 0.0, diagonal, 1.0) ** -0.5
    M = scale[:, None] * M * scale
    M.flat[:: len(M) + 1] += _RIDGE
    return np.asarray(scale[:, None] * np.linalg.inv(M) * scale)


def _length(moves: Iterable[tuple[Array, Array]]) -> float:
    """Share of a step that keeps all values positive."""
    reach = 1.0 / _TO_BOUND
    for value, move in moves:
        falls = move < 0.0
        if falls.any():
            reach = min(reach, float((value[falls] / -move[falls]).min()))
    return min(1.0, _TO_BOUND * max(reach, 0.0))


class SeparableCost(NamedTuple):
    """Sum of f_i(x) = linear_i x + weight_i |x|^p + stiffness_i (x - target_i)^2, p >= 1.

    Attributes:
        weight: Shape (n,), >= 0.
        linear: Shape (n,).
        stiffness: Shape (n,), >= 0.
        target: Shape (n,).
    """

    exponent: float
    weight: Array
    linear: Array
    stiffness: Array
    target: Array

    @property
    def is_quadratic(self) -> bool:
        """Whether slopes are straight lines."""
        return self.exponent == 2.0

    def value(self, x: Array) -> float:
        """The sum of all f_i."""
        power = self.weight * np.abs(x) ** self.exponent
        return float((self.linear * x + power + self.stiffness * (x - self.target) ** 2).sum())

    def slope(self, x: Array) -> Array:
        """The f_i', shape (n,); the middle of all slopes where f_i has a kink."""
        tracking = self.linear + 2.0 * self.stiffness * (x - self.target)
        if self.is_quadratic:
            return tracking + 2.0 * self.weight * x
        p = self.exponent
        return tracking + p * self.weight * np.sign(x) * np.abs(x) ** (p - 1.0)

    def curvature(self, x: Array) -> Array:
        """The f_i'', shape (n,); huge but finite at 0 where p < 2."""
        if self.is_quadratic:
            return 2.0 * (self.stiffness + self.weight)
        p = self.exponent
        size = np.maximum(np.abs(x), TINY ** (1.0 / max(p, 2.0)))
        return 2.0 * self.stiffness + p * (p - 1.0) * self.weight * size ** (p - 2.0)

    def kink(self, x: Array) -> Array:
        """Half the jump of f_i' at x, shape (n,): weight_i at 0 where p = 1, else 0."""
        return np.where((x == 0.0) & (self.exponent == 1.0), self.weight, 0.0)

    def inverse_slope(self) -> Callable[[Array], Array]:
        """The `at_slope` of many slopes."""
        if not self.is_quadratic:
            return self.at_slope
        at_zero = self.linear - 2.0 * self.stiffness * self.target
        curvature = np.maximum(2.0 * (self.stiffness + self.weight), TINY)
        return lambda slope: (slope - at_zero) / curvature

    def at_slope(self, slope: Array) -> Array:
        """The x with f_i' = slope where p > 1, tracking left aside but for p = 2, shape (n,)."""
        if self.is_quadratic:
            return self.inverse_slope()(slope)
        rest = (slope - self.linear) / (self.exponent * np.maximum(self.weight, TINY))
        return np.sign(rest) * np.abs(rest) ** (1.0 / (self.exponent - 1.0))

    def some(self, which: Indices, sign: float = 1.0) -> SeparableCost:
        """Costs of some unknowns, or of their negatives, as functions of them."""
        linear, target = sign * self.linear[which], sign * self.target[which]
        return SeparableCost(
            self.exponent, self.weight[which], linear, self.stiffness[which], target
        )

    def joined(self, other: SeparableCost) -> SeparableCost:
        """Return the costs of these unknowns, then of others."""
        pairs = zip(self[1:], other[1:], strict=True)
        return SeparableCost(self.exponent, *(np.concatenate(pair) for pair in pairs))


def power_cost(exponent: float, weight: Array) -> SeparableCost:
    """The sum of weight_i |x_i|^p."""
    none = np.zeros(len(weight))
    return SeparableCost(float(exponent), weight, none, none, none)


def split_at_zero(cost: SeparableCost, lower: Array, upper: Array) -> Indices:
    """Unknowns with both signs whose f is not twice differentiable at 0, as indices."""
    is_split = (lower < 0.0) & (upper > 0.0) & (cost.exponent < 2.0) & (cost.weight > 0.0)
    return is_split.nonzero()[0]
