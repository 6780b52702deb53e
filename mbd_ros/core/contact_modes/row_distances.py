"""Distances of a state from what event-driven rows reach: gaps g, slip velocities g'.

    projection:   g = 0, then J v + dg/dt = 0 of the active rows, by the least motion in M

A row may be active where its distance is zero: the gap of a unilateral row, the slip velocity of a
row on velocities. A row without a distance, such as a drive that follows within its limit, is
judged by its multiplier.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.rows.constraint import Kind, Level
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowBlock
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ON_SURFACE

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.mode_equations import EventContacts

_CORRECTIONS = 4  # of a configuration


class Distances(NamedTuple):
    """Distances of a state, measured once.

    Attributes:
        x: State of all joints.
        distances: Gaps, slip velocities, and 1 for rows without a distance, shape (n,).
        rates: The g' of all rows, shape (n,); None where no distance needs them.
    """

    x: State
    distances: Array
    rates: Array | None


class RowDistances:
    """Distances to what rows reach: positive in mode 1 and negative in mode -1.

    Args:
        motion: The `FreeMotion` without unilateral and bounded rows.
        rows: These rows.
        at: Which of them are event-driven, shape (n,).
        reach: One entry each of these.
        contacts: The contacts with friction among these; None without any.
    """

    def __init__(
        self,
        motion: Any,
        rows: ConstraintRows,
        at: NDArray[np.intp],
        reach: tuple[Reach, ...],
        contacts: EventContacts | None,
    ) -> None:
        self._motion = motion
        self._rows = rows
        self._at = at
        self._contacts = contacts
        normals = [] if contacts is None else contacts.normals
        self._normals = np.array(normals, dtype=np.intp)
        self._pairs = self._normals[:, None] + (1, 2)
        self._is_gap, self._is_slip, self._is_friction = (
            np.array([kind is wanted for kind in reach], dtype=np.bool_)
            for wanted in (Reach.GAP, Reach.SLIP, Reach.FRICTION)
        )
        self._has_gaps = bool(self._is_gap.any())
        self._has_rates = bool(self._is_slip.any()) or contacts is not None
        rigid = [(block.law.is_rigid, block.level) for block in rows.blocks for _ in block.rows]
        self._rigid = np.flatnonzero([is_rigid for is_rigid, _ in rigid])
        self._rigid_positions = np.flatnonzero(
            [is_rigid and level is Level.POSITION for is_rigid, level in rigid]
        )

    def measure(self, y: State) -> Distances:
        """Measure the distances of a state of what is integrated, and the rates that they need."""
        k, x = self._motion.mechanism.k, self.expand(y)
        rates = self._rates_at(x) if self._has_rates else None
        g = self._rows.residual(k, x)[self._at] if self._has_gaps else None
        return Distances(x, self._distances(g, rates), rates)

    def rates(self, y: State, measured: Distances | None = None) -> Array:
        """Return the g' of all rows, shape (n,).

        Args:
            y: State of what is integrated.
            measured: Its distances, where they are known.
        """
        if measured is not None and measured.rates is not None:
            return measured.rates
        return self._rates_at(self.expand(y))

    def slips(self, measured: Distances) -> tuple[Array, State]:
        """Return the velocities of contacts along their planes, shape (c, 2), and all joints."""
        assert measured.rates is not None
        return measured.rates[self._pairs], measured.x

    def modes(self, y: State, measured: Distances | None = None) -> tuple[Mode, list[int]]:
        """Return the modes that the distances say, and the rows that may be active.

        Args:
            y: State of what is integrated.
            measured: Its distances, where they are known.
        """
        measured = self.measure(y) if measured is None else measured
        return self._modes(measured.x, measured.distances, self.rates(y, measured))

    def modes_at(self, x: State) -> tuple[Mode, list[int]]:
        """Return the same at a state of all joints, with k as the rows need it."""
        rates = self._rates_at(x)
        g = self._rows.residual(self._motion.mechanism.k, x)[self._at] if self._has_gaps else None
        return self._modes(x, self._distances(g, rates), rates)

    def _modes(self, x: State, distances: Array, rates: Array) -> tuple[Mode, list[int]]:
        slack = rounding(x)
        active = np.where(self._is_gap, distances, np.abs(distances)) <= slack
        active &= ~self._is_gap | (rates <= slack)
        active |= ~(self._is_gap | self._is_slip)
        if self._contacts is not None:
            active[self._pairs] = active[self._normals][:, None]
        sides = np.where((distances < 0.0) & ~self._is_gap, -1, 1)
        return tuple(sides.tolist()), active.nonzero()[0].tolist()

    def project(self, y: State, mode: Mode, *, moves: bool = True) -> State:
        """Return the nearest state on the active rows, in the mass metric: g = 0, then g' = 0.

        Args:
            y: State of what is integrated.
            mode: Begins with one entry a row.
            moves: Whether its velocity changes, too.
        """
        active = np.array([not side for side in mode[: len(self._at)]], dtype=np.bool_)
        gaps = active & self._is_gap
        slips = active & (self._is_gap | self._is_slip | self._is_friction)
        measured = None
        for _ in range(_CORRECTIONS if gaps.any() else 0):
            measured = self.measure(y)
            g = measured.distances
            if np.abs(g[gaps]).max() <= np.spacing(1.0 + np.abs(y.q).max()):
                break
            step = self._least_step(y, g, gaps, self._rigid_positions)
            y = y._replace(q=self._motion.coordinates.chart.integrate(y.q, step))
            measured = None
        if moves and slips.any():
            rate = self.rates(y, measured)
            if np.abs(rate[slips]).max() > np.spacing(np.abs(y.v).max()):
                y = y._replace(v=y.v + self._least_step(y, rate, slips, self._rigid))
        return y

    def expand(self, y: State) -> State:
        """Return the state of all joints, with k as the rows need it."""
        x = self._motion.coordinates.expand(y)
        self._motion.mechanism.k.refresh(x.q, x.v, self._rows.reads)
        return x

    def _rates_at(self, x: State) -> Array:
        k, rows = self._motion.mechanism.k, self._rows
        rates: Array = (rows.jacobian(k, x).dot(x.v) + rows.rate(k, x))[self._at]
        return rates

    def _least_step(
        self, y: State, size: Array, chosen: NDArray[np.bool_], rigid: NDArray[np.intp]
    ) -> Array:
        """Return the smallest step of what is integrated, in the mass metric, that ends a size.

        Rigid rows do not move.
        """
        motion = self._motion
        motion.accelerate(y, None)
        x = self.expand(y)
        J = self._rows.jacobian(motion.mechanism.k, x)[np.append(self._at[chosen], rigid)]
        response = motion.respond(y.q, J.T)
        change = np.append(-size[chosen], np.zeros(len(rigid)))
        share = np.linalg.lstsq(J.dot(response), change, rcond=1.0e-13)[0]
        step: Array = motion.coordinates.integrated(response.dot(share))
        return step

    def _distances(self, g: Array | None, rates: Array | None) -> Array:
        """Return the distances from g and g', where these are needed."""
        distances = np.ones(len(self._at))
        if g is not None:
            distances[self._is_gap] = g[self._is_gap]
        if rates is not None:
            distances[self._is_slip] = rates[self._is_slip]
            if self._contacts is not None:
                slips = rates[self._pairs]
                distances[self._normals + 1] = np.sqrt(np.add.reduce(slips * slips, axis=1))
        return distances


def rounding(x: State) -> float:
    """Return the distance from a surface that counts as none."""
    most = np.maximum.reduce  # as `max`, for a third less time
    return ON_SURFACE * float(1.0 + max(most(np.abs(x.q)), most(np.abs(x.v))))


class Reach(Enum):
    """The quantity that has to be zero before a row may be active."""

    GAP = "gap"  # g, and g': unilateral rows on positions
    SLIP = "slip"  # g': rows on velocities
    DEMAND = "demand"  # g'' + kd g' + kp g: drives, which follow within their limit
    FRICTION = "friction"  # the slip velocity, where the normal before it is active


def reach_of(block: RowBlock, number: int = 0) -> Reach:
    """Return the quantity that has to be zero before a row of a block may be active.

    Args:
        block: The block.
        number: Number of the row in the block.
    """
    if block.law.kind is Kind.CONE:
        return Reach.FRICTION if number % 3 else Reach.GAP
    if block.level is Level.VELOCITY:
        return Reach.SLIP
    return Reach.GAP if block.law.kind is Kind.UNILATERAL else Reach.DEMAND


def stiff(block: RowBlock) -> RowBlock:
    """Return the block without gains, unless it is a drive: active rows hold exactly."""
    if reach_of(block) is Reach.DEMAND:
        return block
    no_gains = np.zeros(len(block.rows))
    return block._replace(gains=(no_gains, no_gains))
