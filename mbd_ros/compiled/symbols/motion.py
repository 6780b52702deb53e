"""Accelerations of what a tier integrates, from dynamics, joint forces and rows."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.coordinates import Coordinates, Entries
from mbd_ros.compiled.symbols.dynamics import LONG, TreeDynamics
from mbd_ros.compiled.symbols.elimination import order_of
from mbd_ros.compiled.symbols.rows import Rows
from mbd_ros.compiled.symbols.sparse_ldl import SparseLdl
from mbd_ros.compiled.symbols.turns import ZERO


class Solution(NamedTuple):
    """What holds at a state.

    Attributes:
        a: Accelerations of what is integrated, SX scalars.
        lam: Multipliers of the rows, SX scalars.
        pivots: What rows leave of themselves: -(J M^-1 J') without those before, SX scalars.
    """

    a: list[Any]
    lam: list[Any]
    pivots: list[Any]


class Motion:
    """Motion of a mechanism with dependent joints, or with rows, or with neither.

    Args:
        dynamics: Of all joints.
        coordinates: What is integrated.
        tau: Generalized forces on all joints, SX scalars.
        rows: Those that hold.
        bias: The b of J a + b = 0, SX scalars, one a row.
        slack: As for `Held`.
    """

    def __init__(
        self,
        dynamics: TreeDynamics,
        coordinates: Coordinates,
        tau: Sequence[Any],
        rows: Rows,
        bias: Sequence[Any],
        slack: Sequence[Any] = (),
    ) -> None:
        self._dynamics, self._coordinates, self._tau = dynamics, coordinates, tau
        self._rows, self._bias, self._slack = rows, bias, slack

    def solutions(self) -> list[Solution]:
        """The same accelerations by all forms that are worth a try."""
        c = self._coordinates
        is_open = not self._rows.J and c.nv == len(self._tau)
        found = []
        if is_open:
            found.append(Solution(self._dynamics.articulated(self._tau), [], []))
        if not is_open or c.nv <= LONG:
            found.append(self._by_factors())
        return found

    def _by_factors(self) -> Solution:
        c = self._coordinates
        drift = [ca.SX(one) for one in c.lifted([ZERO] * c.nv)] if c.moves_on else None
        h = self._dynamics.forces(drift)
        if drift is not None:
            h = self._dynamics.needed(drift)
        left = c.reduced([force - bias for force, bias in zip(self._tau, h, strict=True)])
        held = Held(c.reduced_matrix(self._dynamics.mass), self._rows, c.nv, self._slack)
        return held.solve(left, [-one for one in self._bias])


class Held:
    """Masses beside rows, factorised: M a - J' lam = f, J a + s lam = b.

    Args:
        mass: The lower triangle of M, SX scalars.
        rows: The rows.
        nv: Size of a velocity.
        slack: The s of each row, SX scalars; none where nothing is given.
    """

    def __init__(self, mass: Entries, rows: Rows, nv: int, slack: Sequence[Any] = ()) -> None:
        self._nv, self._m = nv, len(rows.J)
        entries = dict(mass)
        for i, row in enumerate(rows.J):
            entries.update({(nv + i, j): value for j, value in row.items()})
            entries[nv + i, nv + i] = -slack[i] if slack else ZERO
        edges = [at for at, value in entries.items() if not value.is_zero()]
        waits = {i: set(row) for i, row in enumerate(rows.J, nv)}
        order = order_of(edges, nv + self._m, waits)
        self._factors = SparseLdl(entries, order)

    @property
    def size(self) -> int:
        """Operations of a solution, about."""
        return self._factors.size

    def solve(self, forces: Sequence[Any], rates: Sequence[Any]) -> Solution:
        """Accelerations and multipliers for f and b."""
        x = self._factors.solve([*map(ca.SX, forces), *rates])
        pivots = [-self._factors.pivots[i] for i in range(self._nv, self._nv + self._m)]
        return Solution(x[: self._nv], [-one for one in x[self._nv :]], pivots)
