"""The first switching event in a step of a Runge-Kutta method."""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from mbd_ros.core.events.event_location import sign_change
from mbd_ros.core.events.sliding_field import SlidingField
from mbd_ros.core.integration.runge_kutta import RungeKutta
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError

_ON_SURFACE = 1.0e-12  # relative
_SHRINK = 0.125  # of the step, when looking for a place off a surface that was just left


class Event(NamedTuple):
    """End of a mode.

    Attributes:
        surface: Index of the surface.
        way: 0 where the surface is reached, 1 or -1 where the motion stops sliding on it.
    """

    surface: int
    way: int


class StepEvents:
    """Looks through steps that were taken in one mode.

    The margins of a mode are positive in it: height times side of a surface beside which the
    motion runs, 1 - s and 1 + s of one that it slides on. A step is searched by its end; by its
    middle where it slides; and by the lowest point of its dense output between surfaces that it
    first approaches and then leaves. The event is where the step itself, taken again with another
    length, has a margin of zero: it has the order of the method.

    Source: L. Dieci, L. Lopez, J. Comp. Appl. Math. 236, 2012, 3967-3991.

    Args:
        field: The system in its modes.
        inner: Runge-Kutta steps of that field; the last one is searched.
    """

    def __init__(self, field: SlidingField, inner: RungeKutta) -> None:
        self._field, self._inner = field, inner

    def first(
        self, x: State, u: Array | None, after: State, left: Collection[int]
    ) -> tuple[State, Event | None]:
        """State at the first event and the event, or the state after the step and None.

        Args:
            x: Start of the step; what is returned for an event that is there already.
            u: Commands.
            after: End of the step.
            left: Surfaces that the motion is just leaving: heights of rounding do not count there.

        Raises:
            SolveError: A surface is not left.
        """
        whole = h = after.t - x.t
        late = self._late(after, u, left)
        if late is None:
            h = self._inside(x, u, after, left)
            if h < whole:
                late = self._late(self._advanced(x, h), u, left)
            if late is None:
                return (after if h == whole else self._advanced(x, whole, after.t)), None
        done: set[Event] = set()
        while late is not None:
            event = late
            done.add(event)
            h = self._zero(x, u, event, h, left)
            if h <= 4.0 * math.ulp(x.t):
                return x, event
            late = self._late(self._advanced(x, h), u, left, done)
        return self._advanced(x, h), event

    def near(self, x: State) -> set[int]:
        """Surfaces that a state is on to within rounding."""
        return set(np.flatnonzero(np.abs(self._field.heights(x)) <= _rounding(x)).tolist())

    def _late(
        self, x: State, u: Array | None, left: Collection[int], done: Collection[Event] = ()
    ) -> Event | None:
        """The event whose margin is the most negative one; None where none is negative."""
        margins = self._margins(x, u)
        for i in left:
            if margins.get(Event(i, 0), -math.inf) >= -_rounding(x):
                del margins[Event(i, 0)]
        negative = {e: m for e, m in margins.items() if m < 0.0 and e not in done}
        return min(negative, key=lambda event: negative[event], default=None)

    def _margins(self, x: State, u: Array | None) -> dict[Event, float]:
        field = self._field
        h, on = field.heights(x).tolist(), field.sliding
        margins = {Event(i, 0): way * h[i] for i, way in enumerate(field.mode) if way}
        for i, s in zip(on, field.signs(x, u).tolist() if on else (), strict=True):
            margins[Event(i, 1)], margins[Event(i, -1)] = 1.0 - s, 1.0 + s
        return margins

    def _zero(
        self, x: State, u: Array | None, event: Event, h: float, left: Collection[int]
    ) -> float:
        """Length of the step with which a margin is zero, 0 for one that is so at the start."""

        def margin(length: float) -> float:
            return self._margins(self._advanced(x, length), u)[event]

        near, at_near = 0.0, self._margins(x, u)[event]
        if not event.way and event.surface in left:
            near, at_near = h, -1.0
            while at_near <= 0.0:
                near *= _SHRINK
                if near <= 4.0 * math.ulp(x.t):
                    name = self._field.names[event.surface]
                    raise SolveError(
                        f"switching surface {name} is not left at t = {x.t:.9g} s: events "
                        "accumulate there (Zeno), or the motion only touches it"
                    )
                at_near = margin(near)
        if at_near <= 0.0:
            return 0.0
        return sign_change(margin, (near, at_near), (h, margin(h)))

    def _inside(self, x: State, u: Array | None, after: State, left: Collection[int]) -> float:
        """Length after which a margin may be negative, though none is at the end."""
        field, whole = self._field, after.t - x.t
        if field.sliding:
            middle = self._inner.interpolate(x.t + 0.5 * whole)
            if self._late(middle, u, left) is not None:
                return 0.5 * whole
        beside = [i for i, way in enumerate(field.mode) if way and i not in left]
        if not beside:
            return whole
        way = np.array(field.mode)
        first = way * field.rates(x, u)
        if not (first[beside] < 0.0).any():
            return whole
        last = way * field.rates(after, u)
        for i in (i for i in beside if first[i] < 0.0 < last[i]):

            def rate(length: float, i: int = i) -> float:
                there = self._inner.interpolate(x.t + length)
                return float(way[i] * field.rates(there, u)[i])

            lowest = sign_change(rate, (0.0, float(first[i])), (whole, float(last[i])))
            if way[i] * field.heights(self._inner.interpolate(x.t + lowest))[i] < 0.0:
                return lowest
        return whole

    def _advanced(self, x: State, h: float, t: float | None = None) -> State:
        """The step with another length."""
        return self._inner.stages.advance(h, x.t + h if t is None else t)


def _rounding(x: State) -> float:
    """Height that counts as none."""
    return _ON_SURFACE * float(1.0 + max(np.abs(x.q).max(), np.abs(x.v).max()))
