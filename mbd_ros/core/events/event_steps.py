"""Steps of a smooth method from event to event."""

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from mbd_ros.core.events.clearance import Clearance
from mbd_ros.core.events.decision import decided
from mbd_ros.core.events.event import Event
from mbd_ros.core.events.event_log import EventLog
from mbd_ros.core.events.impacts import Impacts, Rest
from mbd_ros.core.events.mode_field import Margin, ModeField
from mbd_ros.core.events.pace import Pace
from mbd_ros.core.events.step_events import StepEvents
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.memory import Memory
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import SolveError

_SHORT = 1.0e-3  # of dt: events this close to one another are counted


class EventSteps(Stepper):
    """Steps that end where a switch of the system is reached or left.

    Each step is taken in one mode. At an event come impacts, all in one solve, and then the mode
    in which the motion goes on; the inner method follows it from the next step on, so that the
    dense output of the finished step keeps its own mode.

    Args:
        field: The system in its modes.
        inner: Steps of that system.
        dt: Step of a fixed-step method, and interval of the output [s].

    Attributes:
        field: As given.
        events: What happened so far.
    """

    events: EventLog
    kept = ("_last", "_u", "_left", "_rests", "_pace", "_followed", "events")

    def __init__(self, field: ModeField, inner: Stepper, dt: float) -> None:
        self.field, self._short = field, _SHORT * dt
        self._inner: Any = inner
        self.system = field.system
        self.is_fixed = inner.is_fixed
        self.guards, self.switches = field.names, field.names[: len(field.mode)]
        self.ends_at_samples = inner.is_fixed and field.rows is not None
        self._search = StepEvents(field, inner)
        self._impacts: Impacts | None = None
        if field.rows is not None and field.gaps:
            self._impacts = Impacts(self.system, field.rows, field.gaps)
        self._clearance = Clearance(self.system, dt)
        self._has_clearance = self._clearance.serves and not (field.surfaces or field.guards.names)
        if hasattr(inner, "stride") and self._has_clearance and self._clearance.is_whole:
            self.stride = self._stride
        self._last: State | None = None
        self._u: Array | None = None
        self._left: frozenset[int] = frozenset()
        self._rests: tuple[Rest, ...] = ()
        self._pace = Pace()
        self._followed: Mode = ()
        self.events = EventLog()

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of the inner method, or to the next event.

        Raises:
            SolveError: The solution is not unique or ends, or events accumulate.
            DivergedError: As the inner method.
        """
        if self._clearance.room > 0.0 and x is self._last and (u is self._u or _same(u, self._u)):
            after = self._inner.step(x, u, end)
            if self._clearance.passes(x, after):
                self._last = after
                return after
            return self._searched(x, u, end, after)
        if not x.t < end:
            return x
        return self._searched(self._settled(x, u), u, end)

    def _stride(self, x: State, u: Array | None, end: float, most: int) -> tuple[State, int]:
        """Several steps at once while no stop is near; as `AdamsSteps.stride`."""
        clearance = self._clearance
        if not (clearance.room > 0.0 and x is self._last and _same(u, self._u)):
            return self.step(x, u, end), 1
        after, count = self._inner.stride(x, u, end, most, clearance.comes_near)
        if clearance.is_clear(after):
            self._last = after
            return after, count
        return self._searched(self._inner.began(), u, end, after), count

    def _searched(
        self, x: State, u: Array | None, end: float, after: State | None = None
    ) -> State:
        """The state after a step, or after the first event in it.

        Args:
            x: State to start from, in its mode.
            u: Inputs.
            end: As for `step`.
            after: State after the step where it was taken already.
        """
        while True:
            rest = min((rest.t for rest in self._rests), default=math.inf)
            self.field.watch(x, u, self._left)
            if after is None:
                after = self._inner.step(x, u, min(end, rest))
            if after is x:
                return x
            after, margin = self._search.first(x, u, after, self._left)
            if after is not x:
                break
            assert margin is not None
            x, after = self._follow(self._happened(x, u, margin)), None
        after = self.field.onto(after, u)
        if self._left:
            self._left &= self.field.close(after, u)
        if margin is not None:
            after = self._happened(after, u, margin)
        elif after.t >= rest:
            after = self._rested(after)
        self._last = after
        self._clearance.room = 0.0
        if self._has_clearance and not (self._left or self._rests or self.field.on):
            self._clearance.measure(after)
        return after

    def settle(self, x: State, u: Array | None) -> State:
        """The state with the mode in which it goes on."""
        self._last = x = self._settled(x, u)
        return x

    def restart(self) -> None:
        """Forget mode, events and earlier steps."""
        self._inner.restart()
        self._forget()

    def take_events(self) -> EventLog:
        """As `Stepper.take_events`."""
        taken, self.events = self.events, EventLog()
        return taken

    def memory(self) -> Memory:
        """Mode, events and the last step."""
        more = {"room": self._clearance.known, "inner": self._inner.memory()}
        return {**super().memory(), "mode": self.field.mode, **more}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        super().recall({name: memory[name] for name in self.kept}, x)
        self.field.mode = self._followed
        self._inner.follow(self.field.accelerator(), self._followed)
        self._inner.recall(memory["inner"], x)
        self._clearance.known = memory["room"]
        self.field.mode = memory["mode"]

    def continue_from(self, x: State) -> None:
        """Continue in the same mode from a corrected state."""
        if self._last is not None:
            self._clearance.moved(self._last, x)
        self._last = x
        self._inner.continue_from(x)

    def interpolate(self, t: float) -> State:
        """State at a time inside the last step, on what was on in it."""
        if self._last is not None and t == self._last.t:
            return self._last
        now, self.field.mode = self.field.mode, self._followed
        try:
            return self.field.onto(self._inner.interpolate(t), self._u)
        finally:
            self.field.mode = now

    def _forget(self) -> None:
        self._last = self._u = None
        self._clearance.room = 0.0
        self._left = frozenset()
        self._rests = ()
        self._pace = Pace()
        self._followed = ()
        self.events = EventLog()

    def _settled(self, x: State, u: Array | None) -> State:
        """The state with the mode of the next step, decided where anything has changed."""
        field = self.field
        is_new = self._last is None or x.t != self._last.t  # otherwise the last one, corrected
        is_changed = not _same(u, self._u)
        if is_changed:
            self._u = None if u is None else u.copy()
        if is_new:
            x = self._begun(self.field.inside(x), u)
            x = self._happened(x, u, None) if self._hits(x) else self.field.onto_rows(x)
        elif is_changed and (field.on or field.drives):
            self._change(self._decided(x, u, {*field.on, *field.near(x)}))
            x = self._switched(x)
        elif ways := field.turned(x):
            self._change(ways)
        return self._follow(x)

    def _switched(self, x: State) -> State:
        """The state in another mode, which inputs that jump have begun."""
        pairs = zip(self.field.names, x.mode, self.field.mode, strict=True)
        names = tuple(name for name, one, other in pairs if one != other)
        after = x._replace(mode=self.field.mode)
        if names:
            self._log(names, x, after, None)
        return after

    def _follow(self, x: State) -> State:
        """Let the inner method follow the mode."""
        field = self.field
        if self._followed != field.mode:
            self._followed = field.mode
            self._inner.follow(field.accelerator(), field.mode)
        return x if x.mode == field.mode else x._replace(mode=field.mode)

    def _happened(self, x: State, u: Array | None, margin: Margin | None) -> State:
        """The state after an event: impacts, then the mode that begins."""
        field, before = self.field, x
        switch, way = margin or (-1, 0)
        fired, impulse = field.fired(x, u, switch), None
        if fired:
            x = self._begun(field.inside(field.reset(x, u, fired)), u)
            self._left |= frozenset(fired)
        hits = self._hits(x)
        if hits:
            x, impulse = self._struck(x, u)
            self._left |= frozenset(fired)
        elif way and not fired:
            self._change(field.leaving(x, u, (switch, way)))
        elif margin and not fired:
            self._change(self._decided(x, u, {*field.on, switch, *field.near(x)}))
        x = field.onto_rows(x)._replace(mode=field.mode)
        names = tuple(field.names[i] for i in sorted({switch, *hits, *fired} - {-1}))
        if not self._rests:
            self._pace = self._pace.after(x.t, self._short, len(field.names), names)
        self._log(names, before, x, impulse)
        return x

    def _hits(self, x: State) -> list[int]:
        return [] if self._impacts is None else self._impacts.hits(x)

    def _struck(self, x: State, u: Array | None) -> tuple[State, Array]:
        """The state after impacts, in its mode, and all impulses."""
        impacts, field = self._impacts, self.field
        assert impacts is not None
        x, impulse = impacts.after(x)
        x = self._begun(x, u)
        rests = impacts.rests(x, u, field.mode)
        if rests:
            self._rests = (*self._rests, *rests)
            self._change({rest.row: 0 for rest in rests})
            x = self._begun(field.onto_rows(x), u)
        return x, impulse

    def _rested(self, x: State) -> State:
        """The state in which gaps are at rest whose bounces have ended."""
        over = sorted({rest.row for rest in self._rests if rest.t <= x.t})
        self._rests = tuple(rest for rest in self._rests if rest.t > x.t)
        self._log(tuple(self.field.names[i] for i in over), x, x, None)
        return x

    def _log(
        self, names: tuple[str, ...], before: State, after: State, impulse: Array | None
    ) -> None:
        if impulse is None:
            impulse = np.zeros(len(self.system.multiplier_rows))
        expand = self.system.expand
        event = Event(after.t, names, expand(before), expand(after), impulse)
        self.events = self.events.after(event)

    def _begun(self, x: State, u: Array | None) -> State:
        """The state with the mode that heights and accelerations say."""
        field = self.field
        field.begin(x)
        self._left = frozenset(field.close(x, u))
        self._change(self._decided(x, u, field.near(x)))
        return x._replace(mode=field.mode)

    def _decided(self, x: State, u: Array | None, on: Collection[int]) -> dict[int, int]:
        """Modes in which switches go on."""
        try:
            return decided(self.field, x, u, on)
        except SolveError as error:
            raise SolveError(f"t = {x.t:.9g} s: {error}") from error

    def _change(self, ways: dict[int, int]) -> None:
        """Switch to another mode."""
        field = self.field
        field.mode = tuple(ways.get(i, way) for i, way in enumerate(field.mode))
        self._left |= frozenset(i for i, way in ways.items() if way)
        self._left -= frozenset(i for i, way in ways.items() if not way)


def _same(one: Array | None, other: Array | None) -> bool:
    """Whether commands are the same bits."""
    if one is None or other is None:
        return one is other
    return one.tobytes() == other.tobytes()
