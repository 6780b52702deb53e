"""Bilateral rows, and all joints from the coordinates that a tier integrates, as expressions."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.scalar import Scalar, plain
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.rows.constraint import Level
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.state import State

# ---- coordinates ------------------------------------------------------------------------------
# All joints from the coordinates that a tier integrates, and forces back.


Entries = dict[tuple[int, int], Any]


class Coordinates:
    """Positions and velocities of all joints: q = F(y), v = G y', a = G y'' + drift.

    Every joint follows one coordinate, so G has one entry a row.

    Args:
        couplings: Dependent joints, which are eliminated; None where all joints are integrated.
        nq: Size of a configuration of all joints.
        nv: Size of a velocity of all joints.
        q: Configuration of what is integrated, an array of numbers.
        v: Its velocity.

    Attributes:
        q: Of all joints, an array of objects.
        v: The same.
        drift: The same.
    """

    def __init__(self, couplings: Couplings | None, nq: int, nv: int, q: Any, v: Any) -> None:
        self.q, self.v, self.drift = (np.zeros(n, dtype=object) for n in (nq, nv, nv))
        self.drift.fill(0.0)
        self._column, self._slope = list(range(nv)), [1.0] * nv
        self.nv = len(v)
        if couplings is None:
            self.q[:], self.v[:] = q, v
            return
        self.q[couplings.q_index], self.v[couplings.v_index] = q, v
        for i, at in enumerate(couplings.v_index.tolist()):
            self._column[at] = i
        for child_q, child_v, parent_q, parent_v, function in couplings.pairs:
            rate = self.v[parent_v]
            self.q[child_q], slope, curvature = function(self.q[parent_q])
            self.v[child_v] = slope * rate
            self.drift[child_v] = slope * self.drift[parent_v] + curvature * rate * rate
            self._column[child_v] = self._column[parent_v]
            self._slope[child_v] = slope * self._slope[parent_v]

    def reduced(self, tau: Any) -> list[Any]:
        """G' tau, from SX scalars to SX scalars."""
        found: list[Any] = [0.0] * self.nv
        for force, column, slope in zip(tau, self._column, self._slope, strict=True):
            found[column] = found[column] + plain(slope) * force
        return found

    def reduced_row(self, row: dict[int, Any]) -> dict[int, Any]:
        """The row J G of a row of J: entries by velocity."""
        found: dict[int, Any] = {}
        for j, value in row.items():
            column, share = self._column[j], plain(self._slope[j]) * value
            found[column] = found[column] + share if column in found else share
        return found

    def reduced_matrix(self, M: Entries) -> Entries:
        """G' M G, of lower triangles of SX scalars."""
        found: Entries = {}
        for (i, j), value in M.items():
            I, J = self._column[i], self._column[j]  # noqa: E741
            at = max(I, J), min(I, J)
            twice = 2.0 if i != j and I == J else 1.0
            share = plain(self._slope[i] * self._slope[j]) * twice * value
            found[at] = found[at] + share if at in found else share
        return found

    def lifted(self, a: Any) -> list[Any]:
        """G y'' + drift: accelerations of all joints, SX scalars or floats."""
        pairs = zip(self._column, self._slope, self.drift, strict=True)
        return [plain(slope) * a[column] + plain(drift) for column, slope, drift in pairs]

    @property
    def moves_on(self) -> bool:
        """Whether a drift exists: a coupling bends."""
        return any(isinstance(one, Scalar) or one != 0.0 for one in self.drift)


# ---- rows -------------------------------------------------------------------------------------
# Bilateral rows as expressions.


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
        blocks: The constraints.
        k: Kinematics of symbols.
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
