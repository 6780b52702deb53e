"""A strictly convex quadratic program with bounded rows, exact on the rows that act.

    min 1/2 x' H x + g' x   subject to   lower <= C x <= upper

Most answers of an estimator violate no row, and are then one solve. Otherwise a kept ProxQP finds
the rows that act; an answer is solved for on them, and rows are exchanged until the conditions of
the optimum hold. Source: J. Nocedal, S. Wright, Numerical Optimization, 2006, ch. 16.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.optimization.box_qp import Sides, passed
from mbd_ros.core.optimization.qp_solvers import KeptProxQp
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

_EXCHANGES = 30
_KEPT = 1.0e-10  # what a row may be beyond its bound, of its size
_PUSHES = 1.0e-12  # multipliers of that size are none, of the largest


class RowBoundedQp:
    """Solves the problem above, for rows and sizes that change from call to call."""

    def __init__(self) -> None:
        self._solver: KeptProxQp | None = None
        self._size = (0, 0)
        self._last: Sides | None = None

    def solve(self, H: Array, g: Array, C: Array, lower: Array, upper: Array) -> Optimum:
        """The optimum.

        Args:
            H: Positive definite, shape (n, n).
            g: Shape (n,).
            C: Shape (m, n).
            lower: Shape (m,), -inf without.
            upper: Shape (m,), inf without.

        Raises:
            SolveError: H is not positive definite, or no x keeps all rows.
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
            found = self._exchanged(factor, free, C, lower, upper, sides, slack)
            if found is not None:
                return found
        raise SolveError("the bounds of the quadratic program contradict one another")

    def _guesses(
        self, H: Array, g: Array, C: Array, lower: Array, upper: Array
    ) -> Iterator[Sides]:
        """Rows that may act: those of the last answer, then those of ProxQP."""
        if self._last is not None and len(self._last) == len(C):
            yield self._last
        n, m = H.shape[0], len(C)
        if self._solver is None or self._size != (n, m):
            self._solver, self._size = KeptProxQp(n, m), (n, m)
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
        """The optimum from a guess of the rows that act; None where exchanges do not end."""
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
    """The answer of a quadratic program.

    Attributes:
        x: Where it is, shape (n,).
        multipliers: Of the rows, positive at a lower bound, shape (m,).
        residual: Largest violation of the conditions of the optimum, relative.
    """

    x: Array
    multipliers: Array
    residual: float
