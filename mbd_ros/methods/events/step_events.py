"""The first event in a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, overload

import numpy as np

from mbd_ros.core.contact_modes.row_distances import rounding
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.events.crossings import narrowed, sign_change
from mbd_ros.methods.events.mode_field import Margin, ModeField
from mbd_ros.methods.integration.stepping import Stepper

_LEFT = 1.0e-7  # of a step, in which a guard of a part has left zero
_SHRINK = 0.125  # of the step, when looking for a place off a surface that was just left


class StepEvents:
    """Looks through steps that were taken in one mode.

    The margins of a mode are positive in it: height times side of a switch that is off, what is
    left of a multiplier to its bounds where one is on. A step is searched by its end; by its
    middle where a switch is on; and by the lowest point of its dense output where it first
    approaches a switch and then leaves it. The event is where the step itself, taken again with
    another length, has a margin of zero: it has the order of the method.

    Source: L. Dieci, L. Lopez, J. Comp. Appl. Math. 236, 2012, 3967-3991.

    Args:
        field: The system in its modes.
        inner: Steps of that field; the last one is searched.
    """

    def __init__(self, field: ModeField, inner: Stepper) -> None:
        self._field, self._inner = field, inner
        self._known: tuple[Any, Any, Array] = (None, None, NONE)

    def first(
        self,
        x: State,
        u: Array | None,
        after: State,
        left: Collection[int],
        kept: Margin | None = None,
    ) -> tuple[State, Margin | None]:
        """State at the first event and its margin, or the state after the step and None.

        Args:
            x: Start of the step; what is returned for an event that is there already.
            after: End of the step.
            left: Switches that the motion is just leaving: heights of rounding do not count there.
            kept: An event at the start that changed nothing: its gap opens by less than rounding.

        Raises:
            SolveError: A switch is not left.
        """
        if found := self._inner.first_event(left):
            h, gap = found
            return (after, None) if math.isinf(h) else (self._advanced(x, h), (gap, 0))
        whole = h = after.t - x.t
        self._pass_over(x, u, after, left)
        late = self._late(after, u, left)
        if late is None:
            h = self._inside(x, u, after, left)
            if h < whole:
                late = self._late(self._advanced(x, h), u, left)
            if late is None:
                return (after if h == whole else self._advanced(x, whole, after.t)), None
        done: set[Margin] = set()
        while late is not None:
            event = late
            done.add(event)
            h = self._zero(x, u, event, h, left, kept)
            if h <= 4.0 * math.ulp(x.t):
                return x, event
            after = self._advanced(x, h)
            late = self._late(after, u, left, done)
            if late is None and self._field.has_contacts:  # bodies may have met and parted before
                before = self._inside(x, u, after, left)
                if before < h:
                    late = self._late(self._advanced(x, before), u, left, done)
                    if late is None:
                        return self._advanced(x, h), event
                    h = before
        return after, event

    def _late(
        self, x: State, u: Array | None, left: Collection[int], done: Collection[Margin] = ()
    ) -> Margin | None:
        """The most negative margin; None where none is negative."""
        margins = self._field.margins(x, u)
        for i in left:
            if margins.get((i, 0), -math.inf) >= -rounding(x):
                del margins[i, 0]
        negative = {e: m for e, m in margins.items() if m < 0.0 and e not in done}
        return min(negative, key=lambda event: negative[event], default=None)

    def _zero(
        self,
        x: State,
        u: Array | None,
        event: Margin,
        h: float,
        left: Collection[int],
        kept: Margin | None,
    ) -> float:
        """Length of the step with which a margin is zero, 0 for one that is so at the start."""
        margin = self._margin(x, u, event)
        near, at_near = 0.0, self._field.margin(x, u, event)
        switch, way = event
        if not way and switch in left:
            near = self._beyond(x, u, event, h, 4.0 * math.ulp(x.t))
            if near == 0.0 and switch in self._field.gaps:
                # It opened by less than rounding: decided anew, and where that changes nothing,
                # it is decided where it has closed again.
                return self._closed_again(x, u, event, h) if event == kept else 0.0
            if near == 0.0:
                name = self._field.names[switch]
                raise SolveError(
                    f"switching surface {name} is not left at t = {x.t:.9g} s: events "
                    "accumulate there (Zeno), or the motion only touches it"
                )
            at_near = margin(near)
        if at_near <= 0.0:
            return 0.0
        at_far = margin(h)  # the step by another sum of times: rounding may have changed the sign
        if at_far >= 0.0:
            return h
        bracket = (near, at_near), (h, at_far)
        if self._field.has_contacts:  # whose steps cost much more than their dense output
            bracket = narrowed(margin, self._seen(x, u, event), *bracket)
            return sign_change(margin, *bracket, math.ulp(x.t))
        return sign_change(margin, *bracket)

    def _margin(self, x: State, u: Array | None, event: Margin) -> Callable[[float], float]:
        """A margin after the step with another length."""
        ask = None
        if not event[1] and event[0] in self._field.gaps:
            ask = self._inner.margin_again(event)

        def margin(length: float) -> float:
            found = math.nan if ask is None else ask(length, x.t + length)
            if math.isnan(found):
                return self._field.margin(self._advanced(x, length), u, event)
            return found

        return margin

    def _seen(self, x: State, u: Array | None, event: Margin) -> Callable[[float], float]:
        """A margin in the dense output of the last step."""
        ask = self._inner.margin_within(event)
        if ask is not None:
            return lambda h: float(ask(x.t + h))
        return lambda h: self._field.margin(self._inner.interpolate(x.t + h), u, event)

    def _beyond(
        self, x: State, u: Array | None, event: Margin, h: float, shortest: float
    ) -> float:
        """A length below h with which a margin is positive that was none at the start, or 0."""
        margin, near = self._margin(x, u, event), _SHRINK * h
        while near > shortest:
            if margin(near) > 0.0:
                return near
            near *= _SHRINK
        return 0.0

    def _closed_again(self, x: State, u: Array | None, event: Margin, h: float) -> float:
        """Length of the step with which a gap is beyond its end by rounding."""
        margin, slack = self._margin(x, u, event), rounding(x)
        at_start, at_end = margin(0.0) + slack, margin(h) + slack
        if at_start <= 0.0 or at_end >= 0.0:
            return h if at_end >= 0.0 else 0.0
        return sign_change(lambda length: margin(length) + slack, (0.0, at_start), (h, at_end))

    def _pass_over(self, x: State, u: Array | None, after: State, left: Collection[int]) -> None:
        """Guards of parts that were zero and go on to the other side do not act in this step."""
        field, whole = self._field, after.t - x.t
        close = [i for i in field.watched if i in left]
        for i in close:
            if self._first_side(x, u, after, i) < -rounding(after):
                field.unwatch(i)
        if close:
            self._advanced(x, whole, after.t)

    def _first_side(self, x: State, u: Array | None, after: State, guard: int) -> float:
        """Margin of a guard that was zero at the start, where it first is something else."""
        whole, slack = after.t - x.t, rounding(x)
        margin, near = self._margin(x, u, (guard, 0)), _LEFT * whole
        while near < whole:
            found = margin(near)
            if abs(found) > slack:
                return found
            near /= _SHRINK
        return self._field.margin(after, u, (guard, 0))

    def _inside(self, x: State, u: Array | None, after: State, left: Collection[int]) -> float:
        """Length after which a margin may be negative, though none is at the end."""
        field, whole = self._field, after.t - x.t
        if field.on or field.drives or field.watched:
            middle = self._inner.interpolate(x.t + 0.5 * whole)
            if self._late(middle, u, left) is not None:
                return 0.5 * whole
            for i in field.watched:
                ends = (field.margin(end, u, (i, 0)) for end in (x, middle, after))
                lowest = whole * _vertex(*ends)
                if lowest and field.margin(self._inner.interpolate(x.t + lowest), u, (i, 0)) < 0.0:
                    return lowest
        beside = [i for i, way in enumerate(field.mode) if way and i not in left]
        if not beside:
            return whole
        way = np.array(field.mode)
        first = way * self._rates(x, u)
        approaches = first < -rounding(x)
        if not approaches[beside].any():
            return whole
        last = way * self._rates(after, u)
        for i in (i for i in beside if approaches[i] and last[i] > 0.0):

            def rate(length: float, i: int = i) -> float:
                there = self._inner.interpolate(x.t + length)
                return float(way[i] * field.rates(there, u)[i])

            lowest = sign_change(rate, (0.0, float(first[i])), (whole, float(last[i])))
            if way[i] * field.heights(self._inner.interpolate(x.t + lowest))[i] < 0.0:
                return lowest
        return whole

    def _rates(self, x: State, u: Array | None) -> Array:
        """The rates of the heights; those of the end of a step serve the next one, too."""
        asked = (self._field.mode, None if u is None else u.tobytes())
        known, known_asked, rates = self._known
        if x is not known or asked != known_asked:
            rates = self._field.rates(x, u)
            self._known = x, asked, rates
        return rates

    def _advanced(self, x: State, h: float, t: float | None = None) -> State:
        """The step with another length."""
        return self._inner.again(h, x.t + h if t is None else t)


def _vertex(start: float, middle: float, end: float) -> float:
    """Where the parabola through values at 0, 1/2 and 1 is lowest, 0 where that is at an end."""
    bend = start - 2.0 * middle + end
    at = 0.5 - (end - start) / (4.0 * bend) if bend > 0.0 else 0.0
    return at if 0.0 < at < 1.0 else 0.0


class Event(NamedTuple):
    """Everything that falls together at one time, to rounding.

    Attributes:
        t: Time [s].
        guards: Names of the guards that were zero, in the order of the scene.
        before: State of all joints before it, with the mode that ends.
        after: State of all joints after resets and impacts, with the mode that begins.
        impulse: One a multiplier of the scene, in the order of `System.multiplier_rows` [N·s,
            N·m·s], shape (m,); 0 where nothing hits.
        share: Of the restitution of contacts that was given back: less than 1 where the whole
            would have gained energy.
        ends_phase: Whether a phase ended, and the next one began.
    """

    t: float
    guards: tuple[str, ...]
    before: State
    after: State
    impulse: Array
    share: float = 1.0
    ends_phase: bool = False


class EventLog(Sequence[Event]):
    """Events in the order of time, a value: one more event makes another log.

    Logs that follow one another share one list, and each knows how far its own part of it goes. So
    one more event, and a log that is kept as part of a checkpoint, cost the same however many
    there are.

    Args:
        events: The first ones.
    """

    def __init__(self, events: Iterable[Event] = ()) -> None:
        self._shared = list(events)
        self._count = len(self._shared)

    def after(self, event: Event) -> EventLog:
        """The log with one more event."""
        longer = EventLog.__new__(EventLog)
        is_newest = len(self._shared) == self._count
        longer._shared = self._shared if is_newest else self._shared[: self._count]
        longer._shared.append(_locked(event))
        longer._count = self._count + 1
        return longer

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Event]:
        return (self._shared[i] for i in range(self._count))

    @overload
    def __getitem__(self, at: int) -> Event: ...
    @overload
    def __getitem__(self, at: slice) -> list[Event]: ...
    def __getitem__(self, at: int | slice) -> Event | list[Event]:
        numbers = range(self._count)[at]
        if isinstance(numbers, range):
            return [self._shared[i] for i in numbers]
        return self._shared[numbers]

    def __reduce__(self) -> tuple[Any, ...]:
        return EventLog, (list(self),)


def _locked(event: Event) -> Event:
    """The event with arrays of its own that nobody can change, since several logs hold them."""
    return event._replace(
        before=_kept(event.before), after=_kept(event.after), impulse=_own(event.impulse)
    )


def _kept(x: State) -> State:
    return State(x.t, _own(x.q), _own(x.v), _own(x.z), x.mode)


def _own(array: Array) -> Array:
    array = array.copy()
    array.flags.writeable = False
    return array
