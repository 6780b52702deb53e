"""Distances of a state from what rows that give way reach: gaps g, slip velocities g'.

    onto:   g = 0, then J v + dg/dt = 0 of the rows that are on, by the least motion in M

A row may be on where its height is zero: the gap of a one-sided row, the slip of a row of
velocities. A row without height, such as a drive that follows within its limit, is judged by its
multiplier.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.rows.constraint import Kind, Level
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowBlock
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ON_SURFACE

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.mode_equations import ExactContacts

_CORRECTIONS = 4  # of a configuration
_KNOWN = 4  # configurations: an event asks often at the start and the end of its step


class RowHeights:
    """Heights are positive in mode 1 and negative in mode -1: gaps, slip velocities.

    Args:
        motion: The `FreeMotion` without rows that give way.
        rows: Rows that give way.
        at: Which of them go from event to event, shape (n,).
        reach: One entry each of these.
        contacts: The contacts with friction among these; None without any.
    """

    def __init__(
        self,
        motion: Any,
        rows: ConstraintRows,
        at: NDArray[np.intp],
        reach: tuple[Reach, ...],
        contacts: ExactContacts | None,
    ) -> None:
        self._motion = motion
        self._rows = rows
        self._at = at
        self._contacts = contacts
        normals = [] if contacts is None else contacts.normals
        self._normals = np.array(normals, dtype=np.intp)
        self._pairs = self._normals[:, None] + (1, 2)
        self._is_gap, self._is_slip, self._is_friction = (
            np.array([one is kind for one in reach], dtype=np.bool_)
            for kind in (Reach.GAP, Reach.SLIP, Reach.FRICTION)
        )
        self._has_gaps = bool(self._is_gap.any())
        self._has_rates = bool(self._is_slip.any()) or contacts is not None
        rigid = [(block.law.is_rigid, block.level) for block in rows.blocks for _ in block.rows]
        self._held = np.flatnonzero([is_held for is_held, _ in rigid])
        self._closed = np.flatnonzero([one == (True, Level.POSITION) for one in rigid])
        self._places: dict[Any, tuple[dict[str, Array], dict[bytes, dict[str, Any]]]] = {}

    def heights(self, y: State) -> Array:
        """Gaps, slip velocities, and 1 for rows without height, shape (n,)."""
        there, known = self._known_at(y)
        if "heights" not in known:
            rates = self.approach(y) if self._has_rates else None
            if self._has_gaps and "g" not in there:
                k, x = self._motion.mechanism.k, self.placed(y)
                there["g"] = self._rows.residual(k, x)[self._at]
            known["heights"] = self._heights(there.get("g"), rates)
        heights: Array = known["heights"].copy()
        return heights

    def approach(self, y: State) -> Array:
        """The g' of all rows, shape (n,)."""
        there, known = self._known_at(y)
        if "rates" not in known:
            if "J" not in there:
                k, x = self._motion.mechanism.k, self.placed(y)
                there["J"], there["rate"] = self._rows.jacobian(k, x), self._rows.rate(k, x)
            v = self._motion.coordinates.expand(y).v
            known["rates"] = (there["J"].dot(v) + there["rate"])[self._at]
        rates: Array = known["rates"].copy()
        return rates

    def slips(self, y: State) -> tuple[Array, State]:
        """The velocities of contacts along their planes, shape (c, 2), and of all joints."""
        return self.approach(y)[self._pairs], self._motion.coordinates.expand(y)

    def ways(self, y: State) -> tuple[Mode, list[int]]:
        """Modes by the heights, and rows that may be on."""
        known = self._known_at(y)[1]
        if "ways" not in known:
            x = self._motion.coordinates.expand(y)
            known["ways"] = self._ways(self.heights(y), self.approach(y), rounding(x))
        ways: tuple[Mode, list[int]] = known["ways"]
        return ways

    def onto(self, y: State, mode: Mode, *, moves: bool = True) -> State:
        """The state on the rows that are on, moved as their forces move it: g = 0, then g' = 0.

        Args:
            y: State of what is integrated.
            mode: Begins with one entry a row.
            moves: Whether its velocity changes, too.
        """
        on = np.array([not way for way in mode[: len(self._at)]], dtype=np.bool_)
        gaps, slips = on & self._is_gap, on & (self._is_gap | self._is_slip | self._is_friction)
        for _ in range(_CORRECTIONS if gaps.any() else 0):
            g = self.heights(y)
            if np.abs(g[gaps]).max() <= np.spacing(1.0 + np.abs(y.q).max()):
                break
            move = self._move(y, g, gaps, self._closed)
            y = y._replace(q=self._motion.coordinates.chart.integrate(y.q, move))
        if moves and slips.any():
            rate = self.approach(y)
            if np.abs(rate[slips]).max() > np.spacing(np.abs(y.v).max()):
                y = y._replace(v=y.v + self._move(y, rate, slips, self._held))
        return y

    def freely(self, y: State, u: Array | None, mode: Mode) -> Array:
        """Accelerations of what is integrated without the rows."""
        mechanism = self._motion.mechanism
        before = mechanism.mode, mechanism.z
        mechanism.mode, mechanism.z = mode, y.z
        try:
            a: Array = self._motion.accelerate(y.t, y.q, y.v, u)
            return a
        finally:
            mechanism.mode, mechanism.z = before

    def placed(self, y: State) -> State:
        """State of all joints, with k as the rows need it."""
        x = self._motion.coordinates.expand(y)
        self._motion.mechanism.k.refresh(x.q, x.v, self._rows.reads)
        return x

    def _move(
        self, y: State, size: Array, chosen: NDArray[np.bool_], held: NDArray[np.intp]
    ) -> Array:
        """The smallest motion of what is integrated, in the mass metric, that ends a size.

        Rows beside them that hold whatever it takes do not move.
        """
        motion = self._motion
        self.freely(y, None, y.mode)
        x = self.placed(y)
        J = self._rows.jacobian(motion.mechanism.k, x)[np.append(self._at[chosen], held)]
        response = motion.respond(y.q, J.T)
        change = np.append(-size[chosen], np.zeros(len(held)))
        share = np.linalg.lstsq(J.dot(response), change, rcond=1.0e-13)[0]
        move: Array = motion.coordinates.integrated(response.dot(share))
        return move

    def _heights(self, g: Array | None, rates: Array | None) -> Array:
        """The heights from g and g', where these are needed."""
        heights = np.ones(len(self._at))
        if g is not None:
            heights[self._is_gap] = g[self._is_gap]
        if rates is not None:
            heights[self._is_slip] = rates[self._is_slip]
            if self._contacts is not None:
                slips = rates[self._pairs]
                heights[self._normals + 1] = np.sqrt(np.add.reduce(slips * slips, axis=1))
        return heights

    def ways_at(self, x: State) -> tuple[Mode, list[int]]:
        """The same at a state of all joints, with k as the rows need it."""
        k, rows = self._motion.mechanism.k, self._rows
        rates = (rows.jacobian(k, x).dot(x.v) + rows.rate(k, x))[self._at]
        g = rows.residual(k, x)[self._at] if self._has_gaps else None
        return self._ways(self._heights(g, rates), rates, rounding(x))

    def _known_at(self, y: State) -> tuple[dict[str, Array], dict[str, Any]]:
        """What was found at the configuration of a state, and at the state, of the last few."""
        place = y.t, y.mode, y.q.tobytes(), y.z.tobytes()
        found = self._places.get(place)
        if found is None:
            if len(self._places) == _KNOWN:
                del self._places[next(iter(self._places))]
            found = self._places[place] = {}, {}
        return found[0], found[1].setdefault(y.v.tobytes(), {})

    def _ways(self, heights: Array, rate: Array, slack: float) -> tuple[Mode, list[int]]:
        """As `ways_at`, with what counts as none."""
        on = np.where(self._is_gap, heights, np.abs(heights)) <= slack
        on &= ~self._is_gap | (rate <= slack)
        on |= ~(self._is_gap | self._is_slip)
        if self._contacts is not None:
            on[self._pairs] = on[self._normals][:, None]
        ways = np.where((heights < 0.0) & ~self._is_gap, -1, 1)
        return tuple(ways.tolist()), on.nonzero()[0].tolist()


def rounding(x: State) -> float:
    """Height over a surface that counts as none."""
    most = np.maximum.reduce  # as `max`, for a third less time
    return ON_SURFACE * float(1.0 + max(most(np.abs(x.q)), most(np.abs(x.v))))


class Reach(Enum):
    """What has to be zero before a row may be on."""

    GAP = "gap"  # g, and g': one-sided rows of positions
    SLIP = "slip"  # g': rows of velocities
    DEMAND = "demand"  # g'' + kd g' + kp g: drives, which follow within their limit
    FRICTION = "friction"  # the slip, where the normal before it is on


def reach_of(block: RowBlock, own: int = 0) -> Reach:
    """What has to be zero before a row of a block may be on.

    Args:
        own: Number of the row in it.
    """
    if block.law.kind is Kind.CONE:
        return Reach.FRICTION if own % 3 else Reach.GAP
    if block.level is Level.VELOCITY:
        return Reach.SLIP
    return Reach.GAP if block.law.kind is Kind.UNILATERAL else Reach.DEMAND


def stiff(block: RowBlock) -> RowBlock:
    """The block without gains, unless it is a drive: what is on is on exactly."""
    if reach_of(block) is Reach.DEMAND:
        return block
    nothing = np.zeros(len(block.rows))
    return block._replace(gains=(nothing, nothing))
