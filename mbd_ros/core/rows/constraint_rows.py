"""All rows of several constraints, stacked."""

import itertools
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.parts import Constraint, Row, Wrench
from mbd_ros.core.rows.row_order import numbered
from mbd_ros.core.state import Array, State


class ConstraintRows:
    """g(t, q) = 0 of several constraints, one below the other.

    Args:
        parts: The constraints.
        nv: Size of the velocity of the robot.
        rows: Their rows, numbered as in the scene; by default the rows of `parts` alone.

    Attributes:
        rows: One entry a row.
        slices: Where the rows of each part stand.
        reads: What the parts read of k.
        lower: Smallest multiplier of every row, -inf where it is free, shape (m,).
        upper: Largest multiplier of every row, shape (m,).
        is_corrected: Whether any row demands more than g'' = 0.
    """

    def __init__(
        self, parts: Sequence[Constraint], nv: int, rows: tuple[Row, ...] | None = None
    ) -> None:
        self.parts = tuple(parts)
        own = [row for part in parts for row in part.rows]
        self.rows = numbered(own) if rows is None else rows
        ends = np.cumsum([0, *(len(part.rows) for part in parts)]).tolist()
        self.slices = [slice(*pair) for pair in itertools.pairwise(ends)]
        self.reads = max((part.reads for part in parts), default=Reads.NOTHING)
        m = len(self.rows)
        self.lower, self.upper = np.full(m, -np.inf), np.full(m, np.inf)
        self._kp, self._kd = np.zeros(m), np.zeros(m)
        for part, mine in zip(self.parts, self.slices, strict=True):
            self._kp[mine], self._kd[mine] = part.gains
            self.lower[mine], self.upper[mine] = part.law.lower, part.law.upper
        self.is_corrected = bool(self._kp.any() or self._kd.any())
        self._J, self._drift = np.zeros((m, nv)), np.zeros(m)
        self._none, self._no_rows = np.zeros(0), np.zeros((0, nv))
        self._only = self.parts[0] if len(self.parts) == 1 else None

    def correct_free_rows(self, kp: float, kd: float) -> None:
        """Demand g'' + kd g' + kp g = 0 of the rows without bounds."""
        free = np.isinf(self.lower) & np.isinf(self.upper)
        self._kp[free], self._kd[free] = kp, kd
        self.is_corrected = bool(self._kp.any() or self._kd.any())

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """J and drift with g'' = J a + drift: (m, nv) and (m,), overwritten by the next call."""
        if self._only is not None:
            return self._only.accelerations(k, x)
        for part, mine in zip(self.parts, self.slices, strict=True):
            self._J[mine], self._drift[mine] = part.accelerations(k, x)
        return self._J, self._drift

    def conditions(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """J and b of the condition J a + b = g'' + kd g' + kp g, (m, nv) and (m,)."""
        J, drift = self.accelerations(k, x)
        if self._only is not None:
            rate, g = J.dot(x.v) + self._only.rate(k, x), self._only.residual(k, x)
        else:
            rate, g = J.dot(x.v) + self.rate(k, x), self.residual(k, x)
        return J, drift + self._kd * rate + self._kp * g

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Wrenches of the multipliers, shape (m,), on bodies, for parts that act on frames."""
        pairs = zip(self.parts, self.slices, strict=True)
        return tuple(w for part, mine in pairs for w in part.wrenches(k, x, lam[mine]))

    def residual(self, k: Kinematics, x: State) -> Array:
        """g, shape (m,)."""
        return np.concatenate([self._none, *(part.residual(k, x) for part in self.parts)])

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """dg/dq, shape (m, nv), fresh."""
        return np.concatenate([self._no_rows, *(part.jacobian(k, x) for part in self.parts)])

    def rate(self, k: Kinematics, x: State) -> Array:
        """dg/dt, shape (m,)."""
        return np.concatenate([self._none, *(part.rate(k, x) for part in self.parts)])
