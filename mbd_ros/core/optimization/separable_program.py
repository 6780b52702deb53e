"""Separable programs: how unknowns that outnumber equations share what these ask for.

    min sum f_i(x_i)   subject to   A x = b,   lower <= x <= upper

Static optimisation of muscles asks it, one frame after the other.
"""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.optimization.qp_solvers import counted
from mbd_ros.core.optimization.separable_cost import SeparableCost
from mbd_ros.core.optimization.separable_interior import interior_start
from mbd_ros.core.optimization.separable_newton import (
    Found,
    Problem,
    ascended,
    multipliers_at,
    refined,
)
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

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
        self._x, self._lam = np.zeros(n), np.zeros(rows)

    def forget(self) -> None:
        """Start the next solve as the first one started."""
        self._x, self._lam = np.zeros(len(self._x)), np.zeros(len(self._lam))

    def solve(
        self, cost: SeparableCost, A: Array, b: Array, lower: Array, upper: Array
    ) -> Optimum:
        """The optimum, fresh arrays.

        Args:
            cost: The f.
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
            found = self._feasible(problem)
            is_feasible = found is not None and not b[is_empty].any()  # nothing fills them
            if found is None:
                found = _least_lacking(problem)
        if not is_feasible:
            self.statistics = counted(self.statistics, "short")
        lacking = b - A.dot(found.x)
        movable = problem.movable(found.x, found.lam)
        lam = scale * found.lam
        return Optimum(found.x.copy(), lam, lacking, found.residual, is_feasible, movable)

    def _feasible(self, problem: Problem) -> Found | None:
        if problem.cost.is_quadratic:
            found = ascended(problem, self._lam)
        else:
            found = refined(problem, self._x, self._lam, _EXCHANGES)
        if found.residual > _SOLVED:
            self.statistics = counted(self.statistics, "cold")
            found = _from_inside(problem)
        if found.residual > _SOLVED:
            return None
        self._x, self._lam = found.x, found.lam
        return found


def _from_inside(problem: Problem) -> Found:
    """From nothing; unknowns whose bounds meet stay aside, high exponents are risen to."""
    cost, A, b, lower, upper = problem
    x, is_open = lower.copy(), upper > lower
    some, rest = is_open.nonzero()[0], b - A[:, ~is_open].dot(lower[~is_open])
    first = cost._replace(exponent=min(cost.exponent, _GENTLE))
    x[some], lam = interior_start(first.some(some), A[:, some], rest, lower[some], upper[some])
    found = refined(problem._replace(cost=first), x, lam, _REFINING)
    while first.exponent < cost.exponent and found.residual <= _NEAR:
        first = cost._replace(exponent=min(cost.exponent, _RISE * first.exponent))
        harder = problem._replace(cost=first)
        found = ascended(harder, multipliers_at(harder, found.x))
    is_done = first.exponent == cost.exponent
    return found if is_done else found._replace(residual=np.inf)


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
