"""All rows of a scene in one order, under every solver."""

import itertools
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.multiplier_laws import Kind, Law, Level
from mbd_ros.core.names import label
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import ModelError


class Cone(NamedTuple):
    """One contact with friction: the rows of its normal and two tangents.

    Attributes:
        name: That of the row of its normal.
        slots: Its three rows, among those of the scene or of who asks.
        mu: Coefficient of friction.
        e: Restitution along the normal.
    """

    name: str
    slots: slice
    mu: float
    e: float


class RowBlock(NamedTuple):
    """The rows of one constraint, as solvers see them.

    Attributes:
        part: The constraint.
        rows: One entry a row, of a name that no other row has.
        slots: Where their multipliers stand among those of the scene, in every mode.
        level: Whether they state positions or velocities.
        law: What the multipliers may be.
        gains: kp [1/s^2] and kd [1/s] of every row, shape (m,) each.
        smoothed: Whether rows that give way are solved for in every evaluation.
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
        """Smallest and largest multiplier at a state: one number or one a row, each."""
        lower, upper = self.law.lower, self.law.upper
        return (
            lower(k, x) if callable(lower) else lower,
            upper(k, x) if callable(upper) else upper,
        )

    def cones(self, first: int | None = None) -> list[Cone]:
        """One entry a contact with friction.

        Args:
            first: Where the rows of the block begin; its place among those of the scene is the
                default.
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


class RowLayout:
    """Couplings first, then constraints as the scene lists them.

    The one place that knows which multipliers of an `Evaluation` belong to which rows.

    Args:
        parts: Couplings and constraints, in that order.

    Attributes:
        rows: One entry a multiplier, as columns call it: `<part>.<quantity>`.
        blocks: One entry a constraint.
        rigid: Blocks that hold whatever multipliers that takes.
        yielding: The other blocks.
        exact: Those of them that give way at events only.
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
        self.exact = tuple(block for block in self.yielding if not block.smoothed)
        self.smoothed = tuple(block for block in self.yielding if block.smoothed)
        self.cones = tuple(cone for block in self.blocks for cone in block.cones())

    def of(self, level: Level) -> tuple[RowBlock, ...]:
        """Blocks of one level; a projection of positions asks for `Level.POSITION`."""
        return tuple(block for block in self.blocks if block.level is level)

    def on(self, mode: Mode) -> tuple[RowBlock, ...]:
        """Blocks that act in a mode; their slots are the same in every mode."""
        return tuple(block for block in self.blocks if block.part.acts(mode))

    def having(self, *kinds: Kind) -> tuple[RowBlock, ...]:
        """Blocks whose law is of one of these kinds."""
        return tuple(block for block in self.blocks if block.law.kind in kinds)


def rigid(parts: Sequence[Constraint]) -> list[Constraint]:
    """Constraints that hold whatever multipliers that takes: without stops and dry friction."""
    return [part for part in parts if part.law.is_rigid]


def labelled(parts: Sequence[Constraint]) -> tuple[Row, ...]:
    """All rows, as columns and messages call them: `<part>.<row>`, numbered where that repeats."""
    rows = [row._replace(name=label(part, row.name)) for part in parts for row in part.rows]
    return numbered(rows)


def numbered(rows: Sequence[Row]) -> tuple[Row, ...]:
    """The rows; equal names get a number: bar, bar#2, bar#3."""
    seen: Counter[str] = Counter()
    told_apart = []
    for row in rows:
        seen[row.name] += 1
        count = seen[row.name]
        told_apart.append(row if count == 1 else row._replace(name=f"{row.name}#{count}"))
    return tuple(told_apart)


def _block(part: Constraint, rows: tuple[Row, ...], slots: slice) -> RowBlock:
    where = f"constraint {type(part).__name__}"
    if rows:
        where = f"{where} with row {rows[0].name}"
    if hasattr(part, "bounds"):
        raise ModelError(
            f"{where} has bounds: say law = box(lower, upper) of core/multiplier_laws.py"
        )
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
