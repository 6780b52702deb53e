"""Rows of several blocks, stacked."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from mbd_ros.core.contracts.parts import Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.multiplier_laws import Kind, Level
from mbd_ros.core.rows.row_layout import RowBlock
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError

Residual = Callable[[Kinematics, State], Array]


class ConstraintRows:
    """g(t, q) = 0 of several blocks, one below the other.

    Args:
        blocks: The blocks, of one `RowLayout`.
        nv: Size of the velocity of the robot.
        gains: kp [1/s^2] and kd [1/s] of rows that do not give way.

    Attributes:
        blocks: As given.
        gains: As given.
        cones: Contacts with friction among these rows, their slots counted here.
        parts: Their constraints.
        rows: One entry a row.
        slots: Where their multipliers stand among those of the scene, shape (m,).
        slices: Where the rows of each block stand here.
        reads: What the parts read of k.
        lower: Smallest multiplier of every row, -inf where it is free, shape (m,).
        upper: Largest multiplier of every row, shape (m,).
        varies: Whether some of these depend on the state; `limit` brings them there.
        is_corrected: Whether any row demands more than g'' = 0.
        is_rate: Which rows state velocities, and have no g, shape (m,).
    """

    def __init__(
        self, blocks: Sequence[RowBlock], nv: int, gains: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self.blocks, self.gains = tuple(blocks), gains
        self.parts = tuple(block.part for block in blocks)
        self.rows = tuple(row for block in blocks for row in block.rows)
        every = [np.arange(block.slots.start, block.slots.stop) for block in blocks]
        self.slots = np.concatenate([np.zeros(0, dtype=np.intp), *every])
        ends = np.cumsum([0, *(len(block.rows) for block in blocks)]).tolist()
        self.slices = [slice(*pair) for pair in itertools.pairwise(ends)]
        each = zip(self.blocks, self.slices, strict=True)
        self.cones = tuple(cone for block, mine in each for cone in block.cones(mine.start))
        self.reads = max((part.reads for part in self.parts), default=Reads.NOTHING)
        m = len(self.rows)
        self.lower, self.upper = np.full(m, -np.inf), np.full(m, np.inf)
        self._kp, self._kd = np.zeros(m), np.zeros(m)
        self.is_rate = np.zeros(m, dtype=np.bool_)
        for block, mine in zip(self.blocks, self.slices, strict=True):
            self._kp[mine], self._kd[mine] = gains if block.law.is_rigid else block.gains
            self.is_rate[mine] = block.level is Level.VELOCITY
            if block.law.kind is Kind.CONE:  # what friction may be depends on the normal
                self.lower[mine], self.upper[mine], self.is_rate[mine] = 0.0, 0.0, True
                normals = slice(mine.start, mine.stop, 3)
                self.upper[normals], self.is_rate[normals] = np.inf, False
            elif not block.law.varies:
                self.lower[mine], self.upper[mine] = block.law.lower, block.law.upper
        self.varies = any(block.law.varies for block in self.blocks)
        self.is_corrected = bool(self._kp.any() or self._kd.any())
        self._J, self._drift = np.zeros((m, nv)), np.zeros(m)
        self._none, self._no_rows = np.zeros(0), np.zeros((0, nv))
        self._only = self.parts[0] if len(self.parts) == 1 else None
        self._residuals = [_residual(block) for block in self.blocks]

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """J and drift with g'' = J a + drift: (m, nv) and (m,), overwritten by the next call."""
        if self._only is not None:
            return self._only.accelerations(k, x)
        for part, mine in zip(self.parts, self.slices, strict=True):
            self._J[mine], self._drift[mine] = part.accelerations(k, x)
        return self._J, self._drift

    def pushes(self, k: Kinematics, x: State) -> Array:
        """D, with the force D' lam on the joints, shape (m, nv), fresh; J while nothing slips."""
        return np.concatenate([self._no_rows, *(part.pushes(k, x) for part in self.parts)])

    def conditions(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """J and b of the condition J a + b = g'' + kd g' + kp g, (m, nv) and (m,)."""
        J, drift = self.accelerations(k, x)
        if not self.is_corrected:
            return J, drift
        if self._only is not None:
            rate, g = J.dot(x.v) + self._only.rate(k, x), self._residuals[0](k, x)
        else:
            rate, g = J.dot(x.v) + self.rate(k, x), self.residual(k, x)
        return J, drift + self._kd * rate + self._kp * g

    def limit(self, k: Kinematics, x: State) -> None:
        """Bring `lower` and `upper` of rows whose bounds depend on the state there.

        Raises:
            SolveError: A lower bound is above the upper one; names the row.
        """
        for block, mine in zip(self.blocks, self.slices, strict=True):
            if block.law.varies:
                self.lower[mine], self.upper[mine] = block.limits(k, x)
        ordered = self.lower <= self.upper
        if not ordered.all():
            row = self.rows[int(ordered.argmin())].name
            raise SolveError(f"the lower bound of row {row} is above the upper one")

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Wrenches of the multipliers, shape (m,), on bodies, for parts that act on frames."""
        pairs = zip(self.parts, self.slices, strict=True)
        return tuple(w for part, mine in pairs for w in part.wrenches(k, x, lam[mine]))

    def residual(self, k: Kinematics, x: State) -> Array:
        """g, shape (m,); 0 for rows of velocities, which have none."""
        return np.concatenate([self._none, *(g(k, x) for g in self._residuals)])

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """dg/dq, shape (m, nv), fresh."""
        return np.concatenate([self._no_rows, *(part.jacobian(k, x) for part in self.parts)])

    def rate(self, k: Kinematics, x: State) -> Array:
        """dg/dt, shape (m,)."""
        return np.concatenate([self._none, *(part.rate(k, x) for part in self.parts)])


def _residual(block: RowBlock) -> Residual:
    if block.level is Level.POSITION:
        return block.part.residual
    nothing = np.zeros(len(block.rows))
    return lambda k, x: nothing
