"""The rows of a scene in one order, the same for every solver, and stacked blocks of rows."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Wrench, label
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Kind, Law, Level, Row
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import ModelError, SolveError

Residual = Callable[[Kinematics, State], Array]
_Numbers = Kinematics | type[Kinematics]  # nothing moves, so its kind of numbers is all


class ConstraintRows:
    """g(t, q) = 0 of several blocks, one below the other.

    Args:
        blocks: The blocks, of one `RowLayout`.
        nv: Size of the velocity of the robot.
        gains: kp [1/s^2] and kd [1/s] of bilateral rows.

    Attributes:
        cones: Contacts with friction among these rows, their slots counted here.
        rows: One entry a row.
        slots: Places of their multipliers among those of the scene, shape (m,).
        slices: Places of the rows of each block here.
        reads: Level of the kinematics that the parts read.
        lower: Smallest multiplier of every row, -inf where it is free, shape (m,).
        upper: Largest multiplier of every row, shape (m,).
        varies: Whether some bounds depend on the state; `limit` evaluates them.
        is_corrected: Whether any row has gains, g'' + kd g' + kp g = 0.
        is_rate: Which rows are on velocities, without a g, shape (m,).
    """

    def __init__(
        self, blocks: Sequence[RowBlock], nv: int, gains: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self.blocks = tuple(blocks)
        self.gains = gains
        self.parts = tuple(block.part for block in blocks)
        self.rows = tuple(row for block in blocks for row in block.rows)
        slots = [np.arange(block.slots.start, block.slots.stop) for block in blocks]
        self.slots = np.concatenate([np.zeros(0, dtype=np.intp), *slots])
        ends = np.cumsum([0, *(len(block.rows) for block in blocks)]).tolist()
        self.slices = [slice(*pair) for pair in itertools.pairwise(ends)]
        pairs = zip(self.blocks, self.slices, strict=True)
        self.cones = tuple(cone for block, at in pairs for cone in block.cones(at.start))
        self.reads = max((part.reads for part in self.parts), default=Reads.NOTHING)
        m = len(self.rows)
        self.lower = np.full(m, -np.inf)
        self.upper = np.full(m, np.inf)
        self._kp = np.zeros(m)
        self._kd = np.zeros(m)
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
        self._J = np.zeros((m, nv))
        self._drift = np.zeros(m)
        self._none = np.zeros(0)
        self._no_rows = np.zeros((0, nv))
        self._only = self.parts[0] if len(self.parts) == 1 else None
        self._residuals = [_residual(block) for block in self.blocks]

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return J and drift with g'' = J a + drift, which the next call overwrites."""
        if self._only is not None:
            return self._only.accelerations(k, x)
        for part, mine in zip(self.parts, self.slices, strict=True):
            self._J[mine], self._drift[mine] = part.accelerations(k, x)
        return self._J, self._drift

    def pushes(self, k: Kinematics, x: State) -> Array:
        """Return D, with the force D' lam on the joints, shape (m, nv), fresh; J without slip."""
        return np.concatenate([self._no_rows, *(part.pushes(k, x) for part in self.parts)])

    def conditions(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return J and b of the condition J a + b = g'' + kd g' + kp g, (m, nv) and (m,)."""
        J, drift = self.accelerations(k, x)
        if not self.is_corrected:
            return J, drift
        if self._only is not None:
            rate, g = J.dot(x.v) + self._only.rate(k, x), self._residuals[0](k, x)
        else:
            rate, g = J.dot(x.v) + self.rate(k, x), self.residual(k, x)
        return J, drift + self._kd * rate + self._kp * g

    def limit(self, k: Kinematics, x: State) -> None:
        """Evaluate `lower` and `upper` of rows whose bounds depend on the state.

        Raises:
            SolveError: A lower bound is above the upper one; names the row.
        """
        for block, mine in zip(self.blocks, self.slices, strict=True):
            if block.law.varies:
                self.lower[mine], self.upper[mine] = block.limits(k, x)
        ordered = self.lower <= self.upper
        if not ordered.all():
            row = self.rows[int(ordered.argmin())].name
            raise SolveError(f"the lower bound of row {row} is above its upper bound")

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the wrenches of the multipliers on bodies, for parts that act on frames."""
        pairs = zip(self.parts, self.slices, strict=True)
        return tuple(w for part, mine in pairs for w in part.wrenches(k, x, lam[mine]))

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return g, shape (m,); 0 for rows on velocities, which have none."""
        return np.concatenate([self._none, *(g(k, x) for g in self._residuals)])

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return dg/dq, shape (m, nv), fresh."""
        return np.concatenate([self._no_rows, *(part.jacobian(k, x) for part in self.parts)])

    def rate(self, k: Kinematics, x: State) -> Array:
        """Return dg/dt, shape (m,)."""
        return np.concatenate([self._none, *(part.rate(k, x) for part in self.parts)])


def _residual(block: RowBlock) -> Residual:
    if block.level is Level.POSITION:
        return block.part.residual
    nothing = np.zeros(len(block.rows))
    return lambda k, x: nothing


class RowLayout:
    """Order of all rows of a scene: couplings first, then constraints as the scene lists them.

    Multipliers of an `Evaluation` have this order.

    Args:
        parts: Couplings and constraints, in that order.

    Attributes:
        rows: One entry a multiplier, named as its column: `<part>.<quantity>`.
        blocks: One entry a constraint.
        rigid: Bilateral blocks, which hold with any multiplier.
        yielding: Unilateral and bounded blocks.
        event_rows: Those of them whose mode changes at events only.
        smoothed: Those that are solved for in every evaluation.
        cones: One entry a contact with friction.

    Raises:
        ModelError: A law or gains that do not fit their rows; names them.
    """

    def __init__(self, parts: Sequence[Constraint] = ()) -> None:
        self.rows = labelled(parts)
        ends = np.cumsum([0, *(len(part.rows) for part in parts)]).tolist()
        slots = (slice(*pair) for pair in itertools.pairwise(ends))
        self.blocks = tuple(
            _block(part, self.rows[mine], mine) for part, mine in zip(parts, slots, strict=True)
        )
        self.rigid = tuple(block for block in self.blocks if block.law.is_rigid)
        self.yielding = tuple(block for block in self.blocks if not block.law.is_rigid)
        self.event_rows = tuple(block for block in self.yielding if not block.smoothed)
        self.smoothed = tuple(block for block in self.yielding if block.smoothed)
        self.cones = tuple(cone for block in self.blocks for cone in block.cones())

    def of(self, level: Level) -> tuple[RowBlock, ...]:
        """Return the blocks of one level."""
        return tuple(block for block in self.blocks if block.level is level)

    def on(self, mode: Mode) -> tuple[RowBlock, ...]:
        """Return the blocks that exist in a mode; their slots are the same in every mode."""
        return tuple(block for block in self.blocks if block.part.acts(mode))

    def having(self, *kinds: Kind) -> tuple[RowBlock, ...]:
        """Return the blocks whose law is of one of these kinds."""
        return tuple(block for block in self.blocks if block.law.kind in kinds)


def _block(part: Constraint, rows: tuple[Row, ...], slots: slice) -> RowBlock:
    where = f"constraint {type(part).__name__}"
    if rows:
        where = f"{where} with row {rows[0].name}"
    law, m = part.law, len(rows)
    try:
        lower = np.broadcast_to(-np.inf if callable(law.lower) else law.lower, m)
        upper = np.broadcast_to(np.inf if callable(law.upper) else law.upper, m)
        kp, kd = (np.broadcast_to(np.asarray(gain, dtype=float), m) for gain in part.gains)
    except ValueError as error:
        raise ModelError(f"{where}: bounds and gains are one number or {m}, one a row") from error
    if not np.all(lower <= upper):
        raise ModelError(f"{where}: the lower bound of a multiplier is above the upper one")
    if not 0.0 <= law.restitution <= 1.0:
        raise ModelError(f"{where}: restitution {law.restitution:g} must be within 0 .. 1")
    block = RowBlock(part, rows, slots, part.level, law, (kp, kd), part.smoothed, part.slips)
    _check_cones(block, where)
    return block


def _check_cones(block: RowBlock, where: str) -> None:
    """Refuse cones that do not fit their rows."""
    if block.law.kind is not Kind.CONE:
        return
    m, mu = len(block.rows), np.atleast_1d(np.asarray(block.law.mu, dtype=float))
    if m == 0 or m % 3:
        raise ModelError(
            f"{where}: a cone has 3 rows a contact, a normal and two tangents; this has {m}"
        )
    if mu.ndim != 1 or len(mu) not in (1, m // 3):
        raise ModelError(f"{where}: friction is one number or {m // 3}, one a contact")
    for each in mu[~((mu >= 0.0) & (mu < np.inf))].tolist():
        raise ModelError(f"{where}: friction {each:g} must be >= 0 and finite")


class RowBlock(NamedTuple):
    """The rows of one constraint, as solvers see them.

    Attributes:
        part: The constraint.
        rows: One entry a row, each with a unique name.
        slots: Places of their multipliers among those of the scene, in every mode.
        level: Whether they are on positions or on velocities.
        law: Law of the multipliers.
        gains: kp [1/s^2] and kd [1/s] of every row, shape (m,) each.
        smoothed: Whether unilateral and bounded rows are solved for in every evaluation.
        slips: Whether multipliers may push along another direction than J'.
    """

    part: Constraint
    rows: tuple[Row, ...]
    slots: slice
    level: Level
    law: Law
    gains: tuple[Array, Array]
    smoothed: bool
    slips: bool

    def limits(self, k: Kinematics, x: State) -> tuple[Any, Any]:
        """Return the smallest and largest multiplier at a state: one number or one a row each."""
        lower, upper = self.law.lower, self.law.upper
        return (
            lower(k, x) if callable(lower) else lower,
            upper(k, x) if callable(upper) else upper,
        )

    def cones(self, first: int | None = None) -> list[Cone]:
        """Return one entry a contact with friction.

        Args:
            first: Number of the first row of the block; by default its slot in the scene.
        """
        if self.law.kind is not Kind.CONE:
            return []
        first = self.slots.start if first is None else first
        starts = range(first, first + len(self.rows), 3)
        mu: list[float] = np.broadcast_to(self.law.mu, len(starts)).tolist()
        return [
            Cone(row.name, slice(start, start + 3), friction, self.law.restitution)
            for row, start, friction in zip(self.rows[::3], starts, mu, strict=True)
        ]


class Cone(NamedTuple):
    """One contact with friction: the rows of its normal and two tangents.

    Attributes:
        name: Name of the row of its normal.
        slots: Numbers of its three rows.
        mu: Coefficient of friction.
        e: Coefficient of restitution along the normal.
    """

    name: str
    slots: slice
    mu: float
    e: float


def labelled(parts: Sequence[Constraint]) -> tuple[Row, ...]:
    """Return all rows with the names of columns: `<part>.<row>`, numbered where that repeats."""
    rows = [row._replace(name=label(part, row.name)) for part in parts for row in part.rows]
    return numbered(rows)


def numbered(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Return the rows with unique names: bar, bar#2, bar#3."""
    seen: Counter[str] = Counter()
    unique = []
    for row in rows:
        seen[row.name] += 1
        count = seen[row.name]
        unique.append(row if count == 1 else row._replace(name=f"{row.name}#{count}"))
    return tuple(unique)


def independent(J: Array) -> list[int]:
    """Return the numbers of rows of a matrix that are no combinations of rows before them."""
    numbers, basis = list[int](), np.zeros((0, J.shape[1]))
    for number, direction in enumerate(J):
        across = direction - basis.T.dot(basis.dot(direction))
        across = across - basis.T.dot(basis.dot(across))
        size = float(np.linalg.norm(across))
        if size**2 > redundant(len(J)) * float(direction.dot(direction)):
            numbers.append(number)
            basis = np.vstack((basis, across / size))
    return numbers


class CouplingRows(Constraint):
    """Rows of the couplings of a scene; each multiplier acts on the dependent joint.

    Args:
        robot: The robot.
        couplings: The couplings, in the order of the rows.

    Attributes:
        pairs: The couplings in indices, parents before children.
    """

    def __init__(self, robot: Robot, couplings: Couplings) -> None:
        self.pairs = couplings.pairs
        self.name = ""  # its multipliers go by the dependent joints
        tied = [robot.joint(name) for name in couplings.dependent]
        self.rows = tuple(Row(f"{one.name}.multiplier", one.effort_unit) for one in tied)
        self._nv = int(robot.model.nv)
        self._constant: tuple[Array, Array] | None = None
        if all(isinstance(pair.function, Linear) for pair in couplings.pairs):
            rest = State(0.0, robot.neutral(), np.zeros(self._nv))
            self._constant = self._jacobian(Kinematics, rest), self._drift(Kinematics, rest)

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift`, which are constant where all functions are linear."""
        return self._constant or (self._jacobian(k, x), self._drift(k, x))

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return q_d - f(q_p), shape (m,)."""
        q = x.q.tolist()
        return k.array([q[i.child_q] - i.function(q[i.parent_q])[0] for i in self.pairs])

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return 1 at the dependent joint and -f' at its parent, shape (m, nv)."""
        return self._jacobian(k, x)

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return -f'' v_p^2, shape (m,)."""
        return self._drift(k, x)

    def _jacobian(self, k: _Numbers, x: State) -> Array:
        shape: Any = len(self.pairs), self._nv
        J = k.zeros(shape)
        for row, i in enumerate(self.pairs):
            J[row, i.child_v] = 1.0
            J[row, i.parent_v] = -i.function(k.item(x.q, i.parent_q))[1]
        return J

    def _drift(self, k: _Numbers, x: State) -> Array:
        q, v = x.q.tolist(), x.v.tolist()  # floats: their squares by ** would not overflow to inf
        return k.array(
            [-i.function(q[i.parent_q])[2] * v[i.parent_v] * v[i.parent_v] for i in self.pairs]
        )


def rigid(parts: Sequence[Constraint]) -> list[Constraint]:
    """Return the bilateral constraints, without stops and dry friction."""
    return [part for part in parts if part.law.is_rigid]
