"""Contact screening: contacts whose gaps a step may close, beside the other rows of the step.

A contact that is farther away than its bodies can go in a few steps is not looked at. What is
known of its gap is reduced by the largest speed of the gap per speed of the joints, times the way
that the joints have gone since; see `core/dynamics/gap_speed_bound`.
"""

import math
from copy import copy

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.gap_speed_bound import GapSpeed, bodies_of
from mbd_ros.core.dynamics.mechanism import ImpulseResponse, Mechanism
from mbd_ros.core.nonsmooth.unilateral_rows import Acting, RowsAt, StepRows
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State

_WAYS = 4.0  # of a step: gaps that may close in it, whatever other rows push
_CURVED = 2.0  # longest way of joints that follow others, of what their velocity says
_ROWS_OF_ONE = 3  # rows of one contact
_SETS = 256  # of rows that are remembered


class ContactScreening(StepRows):
    """Rows that give way; features of contacts only where a step may close their gaps.

    Contacts that are farther away than bodies can go are not looked at. What is remembered of
    them saves time and changes no result.

    Args:
        is_whole: Whether all joints are integrated; others may curve on their way.
    """

    def __init__(self, mechanism: Mechanism, rows: ConstraintRows, is_whole: bool) -> None:
        super().__init__(mechanism, rows)
        self._sets: dict[bytes, Acting] = {}
        self._longer = 1.0 if is_whole else _CURVED
        self._data = mechanism.data
        self._m = len(rows.rows)
        blocks = list(zip(rows.blocks, rows.slices, strict=True))
        own = [(block.part, at) for block, at in blocks if block.law.kind is Kind.CONE]
        others = [(block, at) for block, at in blocks if block.law.kind is not Kind.CONE]
        self._contacts = [(part, np.arange(at.start, at.stop)) for part, at in own]
        self._others = ConstraintRows([block for block, _ in others], int(mechanism.model.nv))
        is_other = np.zeros(self._m, dtype=np.bool_)
        for _, at in others:
            is_other[at] = True
        self._at_others = np.flatnonzero(is_other)
        self._others_push = bool(self.every.pushes[is_other].any())
        self._speed = GapSpeed(mechanism.robot, [bodies_of(part) for part, _ in own])
        self._responded: tuple[bytes, bytes, ImpulseResponse] | None = None
        self._room = np.zeros(len(own))
        self._spare = 0.0
        self._q = mechanism.zero
        self._way = mechanism.zero
        self._ways = mechanism.zero.copy()
        acting = self._acting(self.every.at[:0])
        self._nothing = RowsAt(acting, np.zeros((0, len(self._way))), *np.zeros((3, 0)))

    def turning(self, v: Array) -> float:
        """How fast bodies turn with a velocity of all joints, of all of them together [rad/s]."""
        return float(np.linalg.norm(self._speed.turns * v))

    def begin(self, q: Array) -> None:
        """Learn from which configuration of what is integrated a step starts."""
        if q is not self._q:
            self._room[:] = self._speed.room[:] = self._spare = 0.0

    def moved(self, q: Array, way: Array) -> None:
        """Learn to which configuration all joints moved, and how far, shape (nv,)."""
        self._q, self._way = q, self._longer * way
        way = self._way
        self._ways += np.abs(way)
        self._spare -= math.sqrt(way.dot(way))

    def at(self, x: State, free: Array, h: float) -> RowsAt:
        """The rows at a state of all joints; arguments as for all rows."""
        k, rows, others = self._k, self.rows, self._others
        fastest = math.sqrt(max(x.v.dot(x.v), free.dot(free)))
        if self._spare > _WAYS * h * fastest:
            if not len(self._at_others):
                return self._nothing
            looked_at, ways = [], self._room
        else:
            ways = self._reach(_WAYS * h * np.maximum(np.abs(x.v), np.abs(free)))
            looked_at = np.flatnonzero(self._room <= ways).tolist()
        k.refresh(x.q, x.v, rows.reads if looked_at else others.reads)
        if rows.varies:
            rows.limit(k, x)
        at: list[NDArray[np.intp]] = []
        found: list[tuple[Array, ...]] = []
        if len(self._at_others):
            J, drift = others.accelerations(k, x)
            at.append(self._at_others)
            found.append((J, drift, others.residual(k, x), others.rate(k, x)))
        for i in looked_at:
            part, own = self._contacts[i]
            gap = part.residual(k, x)
            near = np.repeat(gap[::3] < ways[i], 3)
            if near.any():
                each = *part.accelerations(k, x), gap, part.rate(k, x)
                is_whole = near.all()
                at.append(own if is_whole else own[near])
                found.append(each if is_whole else tuple(array[near] for array in each))
        if not found:
            return self._nothing
        if len(found) == 1 and at[0] is not self._at_others:
            J, *known = found[0]
            return RowsAt(self._acting(at[0]), _rounded(J), *known)
        J, *stacked = (np.concatenate(each) for each in zip(*found, strict=True))
        return RowsAt(self._acting(np.concatenate(at)), _rounded(J), *stacked)

    def response(self, held: ImpulseResponse, K: Array, J: Array) -> ImpulseResponse:
        """As of all rows; that of the last step where nothing has turned since."""
        if len(J) <= _ROWS_OF_ONE or not held.is_free:
            return held.of(J)
        key = K.tobytes(), J.tobytes()
        if self._responded is None or key != self._responded[:2]:
            self._responded = *key, held.of(J)
        return copy(self._responded[2])

    def gaps(self, x: State) -> Array | None:
        """The g of one-sided rows at a state of all joints, shape (m,); inf for other rows.

        Contacts that have room are passed over, and count as infinitely far; None where all rows
        are.
        """
        looked_at = list[int]()
        if self._spare <= _WAYS * math.sqrt(self._way.dot(self._way)):
            ways = self._reach(_WAYS * np.abs(self._way))
            looked_at = np.flatnonzero(self._room <= ways).tolist()
        if not looked_at and not self._others_push:
            return None
        self._k.refresh(x.q, x.v, self._of_g)
        if not self._speed.is_measured:
            self._speed.measure(self._data)
        gaps = np.full(self._m, np.inf)
        if self._others_push:
            gaps[self._at_others] = self._others.residual(self._k, x)
        for i in looked_at:
            part, at = self._contacts[i]
            gaps[at] = part.residual(self._k, x)
            pair = getattr(part, "pair", None)
            own = gaps[at[::3]]
            self._room[i] = own.min() if pair is None else pair.room(self._k, own)
        if looked_at:
            self._spare = self._speed.shortest(self._room)
        return np.where(self.every.pushes, gaps, np.inf)

    def _reach(self, way: Array) -> Array:
        """How far gaps change at most on a way of the joints [m], one a contact.

        Brings `room` up to date.
        """
        speed, gone = self._speed, self._speed.weights.dot(self._ways)
        self._room -= gone
        speed.room -= gone
        self._ways[:] = 0.0
        self._spare = speed.shortest(self._room)
        return np.where(speed.room > 0.0, speed.weights.dot(way), np.inf)

    def _acting(self, at: NDArray[np.intp]) -> Acting:
        """The rows that stand there; of a contact all or none."""
        key = at.tobytes()
        if key not in self._sets:
            if len(self._sets) >= _SETS:
                self._sets.clear()
            self._sets[key] = self.every.chosen(at)
        return self._sets[key]


def _rounded(J: Array) -> Array:
    """Rows to the last digit of the largest entry of each column.

    What rounding leaves of entries that are 0 differs from step to step, also of bodies at rest.
    """
    if len(J) <= _ROWS_OF_ONE:
        return J
    large = np.ldexp(1.0, np.frexp(np.abs(J).max(axis=0))[1])
    rounded: Array = (J + large) - large
    return rounded
