"""Accelerations and multipliers of masses beside rows: M a - D' lam = f, J a + s lam = b.

A rigid row has s = 0, one that is off has J = 0 and s = 1, and D = J unless friction of a contact
pushes along with its normal. Rows of contacts may depend on one another: a small softness is added
to their s then, and what it leaves of J a + s lam - b is solved for again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.compiled.symbols.sparse_ldl import Entries, SparseLdl, elimination_order
from mbd_ros.compiled.symbols.symbolic_system import Coordinates
from mbd_ros.compiled.symbols.tree.link_rotations import ZERO
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.rows.constraint import Level
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.state import State

SOFT = 1.0e-9  # of the usual size of a row: what is added to it where rows may be dependent
_AGAIN = 2  # solutions for what that leaves
_SHRUNK = 1.0e-4  # of what softness left: more is left where dependent rows contradict
_OPEN = 1.0e-13  # of 1 + the largest rate: rounding
_IDLE = 1.0e-11  # of multipliers that change no rate: what they may move
_ANY = 1.0e-6  # of a start, squared: what is left of it where multipliers change no rate
Pushes = Mapping[int, Mapping[int, Any]]
NO_PUSHES: Pushes = {}


class ConstrainedMotion:
    """Factors of masses beside rows, and what they solve.

    Args:
        mass: The lower triangle of M, SX scalars.
        nv: Size of a velocity.
        slack: The s of each row, SX scalars; none where nothing is given.
        pushes: The D of rows by their numbers, where it is not J.
        soft: What is added to each s, so that rows may depend on one another, for `balanced`.
    """

    def __init__(
        self,
        mass: Entries,
        rows: Rows,
        nv: int,
        slack: Sequence[Any] = (),
        pushes: Pushes = NO_PUSHES,
        soft: Sequence[float] = (),
    ) -> None:
        self._nv, self._m, self._rows, self._mass = nv, len(rows.J), rows, mass
        self._slack = list(slack) or [ZERO] * self._m
        self._soft = list(soft) or [0.0] * self._m
        entries = dict(mass)
        for i, row in enumerate(rows.J):
            entries.update({(nv + i, j): value for j, value in row.items()})
            entries[nv + i, nv + i] = -(self._slack[i] + self._soft[i])
        upper = {(nv + i, j): entry for i, push in pushes.items() for j, entry in push.items()}
        edges = [at for at, value in (entries | upper).items() if not value.is_zero()]
        self._groups = [
            ([j for j in entry if j < nv], [i - nv for i in entry if i >= nv])
            for entry in connected_groups(edges, nv + self._m)
        ]
        waits = {i: {*row, *pushes.get(i - nv, ())} for i, row in enumerate(rows.J, nv)}
        order = elimination_order(edges, nv + self._m, waits)
        self._factors = SparseLdl(entries, order, upper)

    @property
    def size(self) -> int:
        """Approximate number of operations of a solution."""
        return self._factors.size

    @property
    def pivots(self) -> list[Any]:
        """Pivots of the rows, SX scalars, see `Solution`."""
        return [-self._factors.pivots[i] for i in range(self._nv, self._nv + self._m)]

    def solve(self, forces: Sequence[Any], rates: Sequence[Any]) -> Solution:
        """Return accelerations and multipliers for f and b."""
        x = self._factors.solve([*map(ca.SX, forces), *rates])
        return Solution(x[: self._nv], [-entry for entry in x[self._nv :]], self.pivots)

    def balanced(self, forces: Sequence[Any], rates: Sequence[Any]) -> Solution:
        """Solve with rows that may be dependent, for multipliers of least norm.

        Iterative refinement removes the effect of the regularization on rates. Multipliers that
        change no rate are removed in each group of bodies, where they are multiples of a single
        vector. The solution is sound if the residual of the rates vanishes, and if no other such
        multipliers have an effect.
        """
        solution, still = self.solve(forces, rates), [ZERO] * self._nv
        least = largest(self._left(solution, rates))
        for _ in range(_AGAIN):
            more = self.solve(still, self._left(solution, rates))
            pairs = zip(solution[:2], more[:2], strict=True)
            a, lam = ([x + y for x, y in zip(*pair, strict=True)] for pair in pairs)
            solution = solution._replace(a=a, lam=lam)
        idle = self._idle(0)
        solution = self._without(solution, idle)
        most = _SHRUNK * least + _OPEN * (1.0 + largest(rates))
        is_open = largest(self._left(solution, rates)) > most
        others = self._without(self._idle(self._m), idle)
        moves = self._energy(others.a) > _IDLE * _IDLE / SOFT * sum(self._soft)
        return solution._replace(sound=ca.logic_not(ca.logic_or(is_open, moves)))

    def _idle(self, start: int) -> Solution:
        """Return multipliers that change no rate; they nearly vanish for independent rows."""
        still, lam = [ZERO] * self._nv, [ca.SX(math.cos(1.0 + start + i)) for i in range(self._m)]
        for _ in range(2):  # leaves of any multipliers those that change no rate
            solution = self.solve(still, [x * y for x, y in zip(self._soft, lam, strict=True)])
            lam = solution.lam
        return solution

    def _without(self, solution: Solution, idle: Solution) -> Solution:
        """Return a solution without the component of idle multipliers in each group of bodies."""
        a, lam = list(solution.a), list(solution.lam)
        for joints, rows in self._groups:
            counted = [i for i in rows if not self._slack[i].is_zero()]  # rigid ones are not
            size = sum((idle.lam[i] * idle.lam[i] for i in counted), ZERO)
            along = sum((idle.lam[i] * lam[i] for i in counted), ZERO)
            share = ca.if_else(size > _ANY, along / ca.fmax(size, _ANY), 0.0)
            for i in rows:
                lam[i] = lam[i] - share * idle.lam[i]
            for j in joints:
                a[j] = a[j] - share * idle.a[j]
        return solution._replace(a=a, lam=lam)

    def _left(self, solution: Solution, rates: Sequence[Any]) -> list[Any]:
        """Return the residual of the rates b."""
        each = zip(self._rows.J, self._slack, solution.lam, rates, strict=True)
        return [
            rate - slack * lam - sum((entry * solution.a[j] for j, entry in row.items()), ZERO)
            for row, slack, lam, rate in each
        ]

    def _energy(self, a: Sequence[Any]) -> Any:
        """Return twice the kinetic energy of velocities a."""
        return sum(
            (
                (2.0 if i != j else 1.0) * a[i] * entry * a[j]
                for (i, j), entry in self._mass.items()
            ),
            ZERO,
        )


class Solution(NamedTuple):
    """Accelerations and multipliers at a state.

    Attributes:
        a: Accelerations of integrated coordinates, SX scalars.
        lam: Multipliers of the rows, SX scalars.
        pivots: Pivots of J M^-1 J' in the factorization, SX scalars.
        sound: Positive if dependent rows are solved; None without such rows.
    """

    a: list[Any]
    lam: list[Any]
    pivots: list[Any]
    sound: Any = None


class Rows(NamedTuple):
    """Rows of one or more constraints: J a + drift = 0 keeps g' = J v + rate and g.

    Attributes:
        J: Entries that are not zero by row and velocity, SX scalars.
        drift: SX scalars, one a row.
        g: The same; 0 for rows of velocities.
        level: Level of each row.
    """

    J: list[dict[int, Any]]
    drift: list[Any]
    g: list[Any]
    rate: list[Any]
    level: list[Level]

    def velocities(self, v: Sequence[Any]) -> list[Any]:
        """Return J v + rate, one SX scalar a row."""
        return [
            sum((value * v[j] for j, value in row.items()), rate)
            for row, rate in zip(self.J, self.rate, strict=True)
        ]

    def conditions(self, v: Sequence[Any], gains: tuple[float, float]) -> list[Any]:
        """Return the b of J a + b = g'' + kd g' + kp g."""
        kp, kd = gains
        if isinstance(kp, float) and kp == kd == 0.0:
            return self.drift
        parts = zip(self.drift, self.velocities(v), self.g, strict=True)
        return [drift + kd * rate + kp * g for drift, rate, g in parts]

    def of(self, level: Level) -> Rows:
        """Return the rows of one level."""
        return self.only([i for i, other_level in enumerate(self.level) if other_level is level])

    def only(self, indices: Sequence[int]) -> Rows:
        """Return the rows with the given indices."""
        return Rows(*([column[i] for i in indices] for column in self))

    def beside(self, others: Rows) -> Rows:
        """Return these rows, then others."""
        return Rows(*([*entries, *more] for entries, more in zip(self, others, strict=True)))

    def reduced(self, coordinates: Coordinates) -> Rows:
        """Return the rows with J in integrated coordinates."""
        return self._replace(J=[coordinates.reduced_row(row) for row in self.J])


def rows_of(blocks: Sequence[RowBlock], k: Any, x: State) -> Rows:
    """Return the rows of constraints, in their order.

    Args:
        x: State of all joints, in arrays of numbers.

    Raises:
        Untraceable: Names the constraint and why.
    """
    rows = Rows([], [], [], [], [])
    for block in blocks:
        with tracing(block.part):
            _add(rows, block, k, x)
    return rows


def _add(rows: Rows, block: RowBlock, k: Any, x: State) -> None:
    part, n = block.part, len(block.rows)
    J, drift = part.accelerations(k, x)
    g: Any = [0.0] * n if block.level is Level.VELOCITY else part.residual(k, x)
    for row in np.asarray(J, dtype=object).reshape(n, -1):
        entries = {j: ca.SX(plain(entry)) for j, entry in enumerate(row)}
        rows.J.append({j: entry for j, entry in entries.items() if not entry.is_zero()})
    for values, entries_of in ((rows.drift, drift), (rows.g, g), (rows.rate, part.rate(k, x))):
        values.extend(
            ca.SX(plain(entry)) for entry in np.asarray(entries_of, dtype=object).reshape(n)
        )
    rows.level.extend([block.level] * n)


def connected_groups(edges: Iterable[tuple[int, int]], size: int) -> list[list[int]]:
    """Return the groups of numbers below a size that are connected by edges."""
    group = list(range(size))
    for i, j in edges:
        first, second = group[i], group[j]
        if first != second:
            group = [first if each == second else each for each in group]
    return [[i for i in range(size) if group[i] == first] for first in sorted(set(group))]


def largest(values: Sequence[Any]) -> Any:
    """Return the largest absolute value among SX scalars, 0 if there are none."""
    result = ZERO
    for value in values:
        result = ca.fmax(result, ca.fabs(value))
    return result
