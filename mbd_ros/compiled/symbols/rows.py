"""Bilateral rows as expressions: J a + drift = 0 keeps g' = J v + rate and g."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.compiled.symbols.symbolic_system import Coordinates
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.rows.constraint import Level
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.state import State


class Rows(NamedTuple):
    """Rows of one or more constraints: J a + drift = 0 keeps g' = J v + rate and g.

    Attributes:
        J: Entries that are not zero by row and velocity, SX scalars.
        drift: SX scalars, one a row.
        g: The same; 0 for rows of velocities.
        rate: The same.
        level: Level of each row.
    """

    J: list[dict[int, Any]]
    drift: list[Any]
    g: list[Any]
    rate: list[Any]
    level: list[Level]

    def velocities(self, v: Sequence[Any]) -> list[Any]:
        """J v + rate, one SX scalar a row."""
        return [
            sum((value * v[j] for j, value in row.items()), rate)
            for row, rate in zip(self.J, self.rate, strict=True)
        ]

    def conditions(self, v: Sequence[Any], gains: tuple[float, float]) -> list[Any]:
        """The b of J a + b = g'' + kd g' + kp g."""
        kp, kd = gains
        if isinstance(kp, float) and kp == kd == 0.0:
            return self.drift
        parts = zip(self.drift, self.velocities(v), self.g, strict=True)
        return [drift + kd * rate + kp * g for drift, rate, g in parts]

    def of(self, level: Level) -> "Rows":
        """Those of one level."""
        return self.only([i for i, one in enumerate(self.level) if one is level])

    def only(self, kept: Sequence[int]) -> "Rows":
        """Some of them."""
        return Rows(*([column[i] for i in kept] for column in self))

    def beside(self, others: "Rows") -> "Rows":
        """These, then others."""
        return Rows(*([*own, *more] for own, more in zip(self, others, strict=True)))

    def reduced(self, coordinates: Coordinates) -> "Rows":
        """The same with J by the velocities of what is integrated."""
        return self._replace(J=[coordinates.reduced_row(row) for row in self.J])


def rows_of(blocks: Sequence[RowBlock], k: Any, x: State) -> Rows:
    """The rows of constraints, in their order.

    Args:
        x: State of all joints, in arrays of numbers.

    Raises:
        Untraceable: Names the constraint and why.
    """
    found = Rows([], [], [], [], [])
    for block in blocks:
        with tracing(block.part):
            _add(found, block, k, x)
    return found


def _add(found: Rows, block: RowBlock, k: Any, x: State) -> None:
    part, n = block.part, len(block.rows)
    J, drift = part.accelerations(k, x)
    g: Any = [0.0] * n if block.level is Level.VELOCITY else part.residual(k, x)
    for row in np.asarray(J, dtype=object).reshape(n, -1):
        entries = {j: ca.SX(plain(one)) for j, one in enumerate(row)}
        found.J.append({j: one for j, one in entries.items() if not one.is_zero()})
    for values, given in ((found.drift, drift), (found.g, g), (found.rate, part.rate(k, x))):
        values.extend(ca.SX(plain(one)) for one in np.asarray(given, dtype=object).reshape(n))
    found.level.extend([block.level] * n)
