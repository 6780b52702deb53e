"""Gaps that close with a velocity: impacts, and the rest after infinitely many."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contact_modes.event_rows import ExactRows
from mbd_ros.core.contact_modes.row_distances import rounding
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.impacts.impact_map import Impact, VelocityLevel
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import SolveError

_APPROACH = 1.0e-6  # of the velocity: an approach that shows which way friction pushes


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

    def after(self, y: State) -> tuple[State, Impact]:
        """The state after the impacts of all gaps that are closed, and what they are.

        Raises:
            SolveError: Nothing can keep a gap from closing further.
        """
        rows, closed = self._rows, self.closed(y)
        mode = tuple(0 if i in closed else 1 for i in range(len(rows.names)))
        y = rows.onto(y, mode, moves=False)
        x = self._system.expand(y)
        found = self._level.impact(x, rows.slots[closed].tolist())
        return y._replace(v=self._system.reduce(x._replace(v=found.v)).v), found

    def slipping(self, y: State) -> list[int]:
        """Normals of contacts that are closed and slip."""
        return self._rows.slipping(y, self.closed(y))

    def without_collision(
        self, y: State, u: Array | None, slipping: Sequence[int]
    ) -> tuple[State, Impact]:
        """The state after friction has jammed contacts that slip, and what does it.

        Where no acceleration is consistent, normal forces grow without bound, and in no time an
        impulse ends what leads to it: that of an impact with an approach that is nearly none.
        Nothing is given back. Source: F. Génot, B. Brogliato, Eur. J. Mech. A 18, 1999, sec. 5;
        D. Stewart, SIAM Review 42, 2000, sec. 3, on the limit of short steps.

        Args:
            y: State of what is integrated.
            u: Inputs.
            slipping: Normals of the contacts that slip.

        Raises:
            SolveError: No impulse does.
        """
        rows, system, closed = self._rows, self._system, self.closed(y)
        J, _, response = rows.answer(y, u, slipping)
        x = system.expand(y)
        approach = -_APPROACH * float(np.linalg.norm(x.v)) * np.linalg.norm(J, axis=1)
        nudge = np.linalg.lstsq(J.dot(response), approach - J.dot(x.v), rcond=1.0e-13)[0]
        before = x._replace(v=x.v + response.dot(nudge))
        found = self._level.impact(before, rows.slots[closed].tolist(), expands=False)
        after = system.reduce(x._replace(v=found.v))
        if not system.energy(y._replace(v=after.v)) < system.energy(y):
            raise SolveError("no impulse without collision ends it")
        found.p[rows.slots[list(slipping)]] += nudge
        return y._replace(v=after.v), found

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
        rate, slack = rows.approach(y), rounding(y)
        leaving = [i for i in self.closed(y) if mode[i] and rate[i] > 0.0]
        left = rows.rates_left(y, u, mode) if leaving else rate
        for i in (i for i in leaving if left[i] < 0.0):
            v, a, e = float(rate[i]), -float(left[i]), float(rows.restitution[i])
            if e < 1.0 and v * v <= 2.0 * a * slack:
                found.append(Rest(y.t + 2.0 * v / (a * (1.0 - e)), i))
        return found
