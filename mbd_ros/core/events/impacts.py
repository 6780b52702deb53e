"""Gaps that close with a velocity: impacts, and the rest after infinitely many."""

from collections.abc import Sequence
from typing import NamedTuple

from mbd_ros.core.dynamics.exact_rows import ExactRows
from mbd_ros.core.dynamics.row_heights import rounding
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.velocity_level import VelocityLevel
from mbd_ros.core.state import Array, Mode, State


class Rest(NamedTuple):
    """The end of infinitely many bounces.

    Attributes:
        t: Time [s].
        row: Number of the gap among the exact rows.
    """

    t: float
    row: int


class Impacts:
    """Impacts of the gaps of one system.

    Args:
        system: The system.
        rows: Its exact rows.
        gaps: Numbers of those that are gaps.
    """

    def __init__(self, system: System, rows: ExactRows, gaps: Sequence[int]) -> None:
        self._system, self._rows, self._gaps = system, rows, tuple(gaps)
        self._level = VelocityLevel(system)

    def closed(self, y: State) -> list[int]:
        """Gaps that are closed to within rounding."""
        heights, slack = self._rows.heights(y), rounding(y)
        return [i for i in self._gaps if heights[i] <= slack]

    def hits(self, y: State) -> list[int]:
        """Gaps that are closed and close further."""
        closed, slack = self.closed(y), rounding(y)
        if not closed:
            return []
        rate = self._rows.approach(y)
        return [i for i in closed if rate[i] < -slack]

    def after(self, y: State) -> tuple[State, Array]:
        """The state after the impacts of all gaps that are closed, and all impulses.

        Raises:
            SolveError: Nothing can keep a gap from closing further.
        """
        rows, closed = self._rows, self.closed(y)
        mode = tuple(0 if i in closed else 1 for i in range(len(rows.names)))
        y = rows.onto(y, mode, moves=False)
        x = self._system.expand(y)
        found = self._level.impact(x, rows.slots[closed].tolist())
        return y._replace(v=self._system.reduce(x._replace(v=found.v)).v), found.p

    def rests(self, y: State, u: Array | None, mode: Mode) -> list[Rest]:
        """Closed gaps that would open by no more than rounding, and when their bounces end.

        A gap that opens with v while its acceleration is -a bounces for 2 v / (a (1 - e)) more,
        by v^2 / (2 a) at most.

        Args:
            y: State after an impact.
            u: Inputs.
            mode: In which it goes on otherwise.
        """
        rows, found = self._rows, list[Rest]()
        rate = rows.approach(y)
        rows.solve(y, u, mode)
        for i in (i for i in self.closed(y) if mode[i] and rate[i] > 0.0 > rows.left[i]):
            v, a, e = float(rate[i]), -float(rows.left[i]), float(rows.restitution[i])
            if e < 1.0 and v * v <= 2.0 * a * rounding(y):
                found.append(Rest(y.t + 2.0 * v / (a * (1.0 - e)), i))
        return found
