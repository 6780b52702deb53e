"""Search of a step for the first event in it, and the log of events."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, overload

import numpy as np

from mbd_ros.core.contact_modes.row_distances import rounding
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.events.crossings import narrowed, sign_change
from mbd_ros.methods.events.mode_field import FieldDistances, Margin, ModeField
from mbd_ros.methods.integration.stepping import Stepper

_LEFT = 1.0e-7  # of a step, in which a guard of a part has left zero
_SHRINK = 0.125  # of the step, when looking for a place off a surface that was just left


class StepSearch:
    """Search of one step, taken in one mode, for the first event in it.

    The margins of a mode are positive in it: distance times side of a switch that is off, distance
    of a multiplier from its bounds where a switch is active. A step is searched by its end; by its
    middle where a switch is active; and by the lowest point of its dense output where it first
    approaches a switch and then leaves it. The event is where the step itself, taken again with
    another length, has a margin of zero: it has the order of the method.

    Source: L. Dieci, L. Lopez, J. Comp. Appl. Math. 236, 2012, 3967-3991.

    Args:
        field: The switches of the system.
        inner: Steps of the system; the last one is searched.
        x: Start of the step, with its mode.
        u: Inputs held in the step.
        left: Switches that the motion is just leaving: their distances of rounding do not count.
        sides: Sides on which guards of parts act in the step, as `ModeField.guard_sides`.

    Attributes:
        sides: The same, 0 for guards that go on to their other side after they were zero.
    """

    def __init__(
        self,
        field: ModeField,
        inner: Stepper,
        x: State,
        u: Array | None,
        left: Collection[int],
        sides: tuple[int, ...],
    ) -> None:
        self._field = field
        self._inner = inner
        self._x = x
        self._u = u
        self._mode = x.mode
        self._left = left
        self.sides = sides

    def first(
        self, after: State, ineffective: Margin | None = None
    ) -> tuple[State, Margin | None]:
        """Return the state at the first event and its margin, or that after the step and None.

        Args:
            after: End of the step.
            ineffective: An event at the start that changed nothing: its gap opens by less than
                rounding.

        Returns:
            The start of the step itself for an event that is there already.

        Raises:
            SolveError: A switch is not left.
        """
        x = self._x
        if event := self._inner.first_event(self._left):
            h, gap = event
            return (after, None) if math.isinf(h) else (self._state_after(h), (gap, 0))
        full = h = after.t - x.t
        self._ignore_passed_guards(after)
        measured = self._field.measure(after)
        late = self._most_negative(after, measured=measured)
        if late is None:
            h = self._inner_minimum(after, measured)
            if h < full:
                late = self._most_negative(self._state_after(h))
            if late is None:
                return (after if h == full else self._state_after(full, after.t)), None
        done: set[Margin] = set()
        while late is not None:
            margin = late
            done.add(margin)
            h = self._zero(margin, h, ineffective)
            if h <= 4.0 * math.ulp(x.t):
                return x, margin
            after = self._state_after(h)
            late = self._most_negative(after, done)
            if late is None and self._field.has_contacts:  # bodies may have met and parted before
                before = self._inner_minimum(after)
                if before < h:
                    late = self._most_negative(self._state_after(before), done)
                    if late is None:
                        return self._state_after(h), margin
                    h = before
        return after, margin

    def _value(self, y: State, which: Margin) -> float:
        """Return a margin at a state of the step."""
        return self._field.margin(y, self._u, self._mode, which, self.sides)

    def _most_negative(
        self,
        y: State,
        done: Collection[Margin] = (),
        measured: FieldDistances | None = None,
    ) -> Margin | None:
        """Return the most negative margin; None where none is negative."""
        margins = self._field.margins(y, self._u, self._mode, self.sides, measured)
        for i in self._left:
            if margins.get((i, 0), -math.inf) >= -rounding(y):
                del margins[i, 0]
        negative = {e: m for e, m in margins.items() if m < 0.0 and e not in done}
        return min(negative, key=lambda margin: negative[margin], default=None)

    def _zero(self, which: Margin, h: float, ineffective: Margin | None) -> float:
        """Return the length of the step with which a margin is zero; 0 for the start itself."""
        x, value = self._x, self._margin_by_length(which)
        near, at_near = 0.0, self._value(x, which)
        switch, side = which
        if not side and switch in self._left:
            near = self._positive_length(which, h, 4.0 * math.ulp(x.t))
            if near == 0.0 and switch in self._field.gaps:
                # The gap opened by less than rounding: its mode is decided again, and where that
                # changes nothing, it is decided where the gap has closed again.
                return self._closing_length(which, h) if which == ineffective else 0.0
            if near == 0.0:
                name = self._field.names[switch]
                raise SolveError(
                    f"switching surface {name} is not left at t = {x.t:.9g} s: events "
                    "accumulate there (Zeno), or the motion only touches it"
                )
            at_near = value(near)
        if at_near <= 0.0:
            return 0.0
        at_far = value(h)  # the step by another sum of times: rounding may have changed the sign
        if at_far >= 0.0:
            return h
        bracket = (near, at_near), (h, at_far)
        if self._field.has_contacts:  # whose steps cost much more than their dense output
            bracket = narrowed(value, self._margin_in_dense_output(which), *bracket)
            return sign_change(value, *bracket, math.ulp(x.t))
        return sign_change(value, *bracket)

    def _margin_by_length(self, which: Margin) -> Callable[[float], float]:
        """Return a margin after the step as a function of its length."""
        by_stepper = None
        if not which[1] and which[0] in self._field.gaps:
            by_stepper = self._inner.margin_again(which)

        def value(length: float) -> float:
            margin = math.nan if by_stepper is None else by_stepper(length, self._x.t + length)
            if math.isnan(margin):
                return self._value(self._state_after(length), which)
            return margin

        return value

    def _margin_in_dense_output(self, which: Margin) -> Callable[[float], float]:
        """Return a margin in the dense output as a function of the time since the start."""
        t, by_stepper = self._x.t, self._inner.margin_within(which)
        if by_stepper is not None:
            return lambda h: float(by_stepper(t + h))
        return lambda h: self._value(self._inner.interpolate(t + h), which)

    def _positive_length(self, which: Margin, h: float, shortest: float) -> float:
        """Return a length below h with which a margin is positive that starts at 0, or 0."""
        value, near = self._margin_by_length(which), _SHRINK * h
        while near > shortest:
            if value(near) > 0.0:
                return near
            near *= _SHRINK
        return 0.0

    def _closing_length(self, which: Margin, h: float) -> float:
        """Return the length of the step with which a gap is negative by rounding."""
        value, slack = self._margin_by_length(which), rounding(self._x)
        at_start, at_end = value(0.0) + slack, value(h) + slack
        if at_start <= 0.0 or at_end >= 0.0:
            return h if at_end >= 0.0 else 0.0
        return sign_change(lambda length: value(length) + slack, (0.0, at_start), (h, at_end))

    def _ignore_passed_guards(self, after: State) -> None:
        """Let guards of parts not act that were zero and go on to the other side."""
        close = [i for i in self._field.watched(self.sides) if i in self._left]
        for i in close:
            if self._first_side(after, i) < -rounding(after):
                self.sides = self._field.without_guard(self.sides, i)
        if close:
            self._state_after(after.t - self._x.t, after.t)

    def _first_side(self, after: State, guard: int) -> float:
        """Return the margin of a guard that was zero at the start, where it first is not."""
        full, slack = after.t - self._x.t, rounding(self._x)
        value, near = self._margin_by_length((guard, 0)), _LEFT * full
        while near < full:
            margin = value(near)
            if abs(margin) > slack:
                return margin
            near /= _SHRINK
        return self._value(after, (guard, 0))

    def _inner_minimum(self, after: State, measured: FieldDistances | None = None) -> float:
        """Return a length after which a margin may be negative, though none is at the end.

        Args:
            after: End of the step.
            measured: Distances there, where they are known.
        """
        field, mode, x = self._field, self._mode, self._x
        full, watched = after.t - x.t, field.watched(self.sides)
        if field.active(mode) or field.drives(mode) or watched:
            middle = self._inner.interpolate(x.t + 0.5 * full)
            if self._most_negative(middle) is not None:
                return 0.5 * full
            for i in watched:
                ends = (self._value(y, (i, 0)) for y in (x, middle, after))
                lowest = full * _vertex(*ends)
                if lowest and self._value(self._inner.interpolate(x.t + lowest), (i, 0)) < 0.0:
                    return lowest
        beside = [i for i, side in enumerate(mode) if side and i not in self._left]
        if not beside:
            return full
        sides = np.array(mode)
        first = sides * field.rates(x, self._u, mode)
        approaches = first < -rounding(x)
        if not approaches[beside].any():
            return full
        last = sides * field.rates(after, self._u, mode, measured)
        for i in (i for i in beside if approaches[i] and last[i] > 0.0):

            def rate(length: float, i: int = i) -> float:
                y = self._inner.interpolate(x.t + length)
                return float(sides[i] * field.rates(y, self._u, mode)[i])

            lowest = sign_change(rate, (0.0, float(first[i])), (full, float(last[i])))
            if sides[i] * field.distances(self._inner.interpolate(x.t + lowest))[i] < 0.0:
                return lowest
        return full

    def _state_after(self, h: float, t: float | None = None) -> State:
        """Return the end of the step with another length."""
        return self._inner.again(h, self._x.t + h if t is None else t)


def _vertex(start: float, middle: float, end: float) -> float:
    """Return where the parabola through values at 0, 1/2 and 1 is lowest, 0 at an end."""
    bend = start - 2.0 * middle + end
    at = 0.5 - (end - start) / (4.0 * bend) if bend > 0.0 else 0.0
    return at if 0.0 < at < 1.0 else 0.0


class Event(NamedTuple):
    """All guards that are zero at one time, to rounding, and their effect.

    Attributes:
        t: Time [s].
        guards: Names of the guards that were zero, in the order of the scene.
        before: State of all joints before it, with the mode that ends.
        after: State of all joints after resets and impacts, with the mode that begins.
        impulse: One a multiplier of the scene, in the order of `System.multiplier_rows` [N·s,
            N·m·s], shape (m,); 0 where nothing hits.
        share: Share of the restitution of contacts that took place: less than 1 where all of it
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
    """Events in the order of time, as a value: one more event makes another log.

    Logs that follow one another share one list, and each knows how much of it is its own. So the
    cost of one more event, and of a log in a checkpoint, does not grow with the number of events.

    Args:
        events: The first events.
    """

    def __init__(self, events: Iterable[Event] = ()) -> None:
        self._shared = list(events)
        self._count = len(self._shared)

    def after(self, event: Event) -> EventLog:
        """Return the log with one more event."""
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
    """Return the event with copied arrays that nobody can change, since several logs hold them."""
    return event._replace(
        before=_locked_state(event.before),
        after=_locked_state(event.after),
        impulse=_locked_copy(event.impulse),
    )


def _locked_state(x: State) -> State:
    return State(x.t, _locked_copy(x.q), _locked_copy(x.v), _locked_copy(x.z), x.mode)


def _locked_copy(array: Array) -> Array:
    array = array.copy()
    array.flags.writeable = False
    return array
