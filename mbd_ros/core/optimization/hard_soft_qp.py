"""The smallest vector within hard and soft limits; soft ones give way where not all can be kept.

    min 1/2 |y|²   subject to   lower <= G y <= upper

The first n rows of G, a regular matrix, are hard. Where the soft rows cannot be kept beside them,
their excess is the least possible: sum (excess / |row|)² first, |y|² among what attains it.
`controllers/qp_tracking` asks it: drives have hard limits, motion of joints has soft ones.
Source: A. Escande, N. Mansard, P. Wieber, Int. J. Robotics Research 33(7) (2014), on that order.
"""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.optimization.active_set import Sides, passed
from mbd_ros.core.optimization.bounded_least_squares import BoundedLeastSquares
from mbd_ros.core.optimization.hard_soft_optimum import Candidate, candidate
from mbd_ros.core.optimization.qp_solvers import KeptProxQp, counted
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import FIXED_BY_OTHERS, TINY
from mbd_ros.errors import SolveError

_COMPLIANCE = 1.0e-6  # of a soft row of length one
_ACTS = 1.0e-7  # multiplier of a limit that acts; the largest gap is 1
_AT_LIMIT = 1.0e-9  # of the largest gap
_CHANGES = 4  # of the acting limits on one rung


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


class HardSoftQp:
    """Solves the problem above; an answer is exact on its acting limits, and checked.

    A ladder finds the limits that act: first come those that acted twice before, then those of
    a kept ProxQP whose soft rows yield a little, of the same from nothing, and of a descent in
    the box of the hard rows. On these rungs the conditions of the optimum are recomputed, and
    limits are exchanged where they do not hold. The last rung takes the answer of the descent,
    whose excess is nearly the least.

    Args:
        n: Size of y, and number of hard rows.
        soft: Number of soft rows.

    Attributes:
        counts: So far.

    Raises:
        ModelError: proxsuite is not installed.
    """

    def __init__(self, n: int, soft: int) -> None:
        self.counts = Counts()
        size = n + soft
        self._n, self._qp = n, KeptProxQp(size, soft)
        self._H, self._g, self._C = np.zeros((size, size)), np.zeros(size), np.zeros((soft, size))
        self._C[:, n:] = _COMPLIANCE**0.5 * np.eye(soft)
        self._yielding = np.arange(n, size)
        self._low, self._high = np.full(size, -np.inf), np.full(size, np.inf)
        self._side: Sides = np.zeros(size, dtype=np.int8)
        self._is_steady = False  # whether the same limits acted twice

    def solve(self, G: Array, lower: Array, upper: Array) -> Candidate:
        """The optimum.

        Args:
            G: Rows, shape (n + soft, n).
            lower: Shape (n + soft,), -inf without a limit.
            upper: Same, >= lower.

        Raises:
            SolveError: Input that is not finite, lower > upper, or hard rows that are singular.
        """
        if not (np.isfinite(G).all() and (lower <= upper).all()):
            raise SolveError("QP refused: a row is not finite, or lower > upper")
        self.counts = counted(self.counts, "solves")
        G, lower, upper = self._scaled(G, lower, upper)
        size = max(float(lower.max()), float(-upper.min()), TINY)
        try:
            found = self._exact(G, lower, upper, size) or self._damped(G, lower, upper, size)
        except np.linalg.LinAlgError as error:
            self.counts = counted(self.counts, "failed")
            raise SolveError(f"QP not solved: {error}") from error
        if found.is_softened:
            self.counts = counted(self.counts, "softened")
        self._is_steady = bool((found.side == self._side).all())
        self._side = found.side
        return found

    def _scaled(self, G: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Rows of length one; those that nothing moves have no limit."""
        length = np.sqrt((G * G).sum(axis=1))
        soft = length[self._n :]
        scale = 1.0 / np.maximum(length, TINY)
        low, high = scale * lower, scale * upper
        unmoved = self._n + (soft <= FIXED_BY_OTHERS * soft.max(initial=0.0)).nonzero()[0]
        scale[unmoved], low[unmoved], high[unmoved] = 0.0, -np.inf, np.inf
        return scale[:, None] * G, low, high

    def _exact(self, G: Array, lower: Array, upper: Array, size: float) -> Candidate | None:
        if self._is_steady:
            found = candidate(G, lower, upper, self._side, self._n, size)
            if found.is_optimal:
                return found
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
                found = candidate(G, lower, upper, side, self._n, size)
                if found.is_optimal:
                    return found
                side = found.side
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


def _boxed(G: Array, lower: Array, upper: Array, size: float) -> tuple[Array, Sides, bool]:
    """The y where stiff soft rows yield, its limits, and whether it passes one; hard rows hold."""
    n = G.shape[1]
    E: Any = np.linalg.inv(G[:n])
    rows = BoundedLeastSquares(E, G[n:].dot(E), lower[n:], upper[n:])
    y = E.dot(rows.solve(lower[:n], upper[:n]))
    reached, slack = G.dot(y), _AT_LIMIT * size
    is_softened = bool(passed(reached, lower, upper, slack).any())
    return y, passed(reached, lower, upper, -slack), is_softened
