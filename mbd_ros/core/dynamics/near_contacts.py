"""Contacts that a step may close, beside the other rows that give way."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.gap_speed import GapSpeed
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.step_rows import Acting, RowsAt, StepRows
from mbd_ros.core.model.points import Pair
from mbd_ros.core.row_laws import Kind
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State

_WAYS = 4.0  # of a step: gaps that may close in it, whatever other rows push
_SETS = 256  # of rows that are remembered


class NearContacts(StepRows):
    """Rows that give way; features of contacts only where a step may close their gaps.

    Contacts that are farther away than bodies can go are not looked at. What is remembered of
    them saves time and changes no result.

    Args:
        mechanism: The mechanism.
        rows: The rows.
    """

    def __init__(self, mechanism: Mechanism, rows: ConstraintRows) -> None:
        super().__init__(mechanism, rows)
        self._data, self._m = mechanism.data, len(rows.rows)
        blocks = list(zip(rows.blocks, rows.slices, strict=True))
        own = [(block.part, at) for block, at in blocks if block.law.kind is Kind.CONE]
        others = [(block, at) for block, at in blocks if block.law.kind is not Kind.CONE]
        self._contacts = [(part, np.arange(at.start, at.stop)) for part, at in own]
        self._others = ConstraintRows([block for block, _ in others], int(mechanism.model.nv))
        self._at_others = np.concatenate([self.every.at[:0], *(self.every.at[at] for _, at in others)])
        self._speed = GapSpeed(mechanism.robot, [part.pair.bodies for part, _ in own])
        self._room, self._way, self._q = np.zeros(len(own)), np.zeros(len(own)), mechanism.zero
        self._sets: dict[bytes, Acting] = {}

    def begin(self, q: Array) -> None:
        """Learn from which configuration of what is integrated a step starts."""
        if q is not self._q:
            self._room[:] = self._speed.room[:] = 0.0

    def moved(self, q: Array, way: Array) -> None:
        """Learn to which configuration all joints moved, and how far, shape (nv,)."""
        self._q, self._way = q, self._speed.weights.dot(np.abs(way))
        self._room -= self._way
        self._speed.room -= self._way

    def at(self, x: State, free: Array, h: float) -> RowsAt:
        """The rows at a state of all joints; arguments as for all rows."""
        k, rows, others = self._k, self.rows, self._others
        fastest = np.maximum(np.abs(x.v), np.abs(free))
        ways = np.where(self._speed.room > 0.0, self._speed.weights.dot(_WAYS * h * fastest), np.inf)
        looked_at = np.flatnonzero(self._room <= ways).tolist()
        k.refresh(x.q, x.v, rows.reads if looked_at else others.reads)
        if rows.varies:
            rows.limit(k, x)
        J, drift = others.accelerations(k, x)
        found = [(self._at_others, J, drift, others.residual(k, x), others.rate(k, x))]
        for i in looked_at:
            part, at = self._contacts[i]
            gap = part.residual(k, x)
            near = np.repeat(gap[::3] <= ways[i], 3)
            if near.any():
                each = at, *part.accelerations(k, x), gap, part.rate(k, x)
                found.append(each if near.all() else tuple(array[near] for array in each))
        at, *arrays = (np.concatenate(each) for each in zip(*found, strict=True))
        return RowsAt(self._acting(at), *arrays)

    def gaps(self, x: State) -> Array:
        """The g of one-sided rows at a state of all joints, shape (m,); inf for other rows.

        Contacts that have room are passed over, and count as infinitely far.
        """
        speed, gaps = self._speed, np.full(self._m, np.inf)
        looked_at = np.flatnonzero(self._room <= _WAYS * self._way).tolist()
        is_measured = bool((speed.room > 0.0).all())
        if looked_at or not is_measured or len(self._at_others):
            self._k.refresh(x.q, x.v, self._of_g)
        if not is_measured:
            speed.measure(self._data)
        if len(self._at_others):
            gaps[self._at_others] = self._others.residual(self._k, x)
        for i in looked_at:
            part, at = self._contacts[i]
            gaps[at] = part.residual(self._k, x)
            self._room[i] = gaps[at[::3]].min()
        return np.where(self.every.pushes, gaps, np.inf)

    def _acting(self, at: NDArray[np.intp]) -> Acting:
        """The rows that stand there; of a contact all or none."""
        key = at.tobytes()
        if key not in self._sets:
            if len(self._sets) >= _SETS:
                self._sets.clear()
            self._sets[key] = self.every.chosen(at)
        return self._sets[key]

