"""Steps of a smooth method from event to event."""

import math
from typing import Any

from mbd_ros.core.events.clearance import Clearance
from mbd_ros.core.events.event_log import EventLog
from mbd_ros.core.events.mode_field import Margin, ModeField
from mbd_ros.core.events.step_events import StepEvents
from mbd_ros.core.events.transitions import Transitions
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.memory import Memory
from mbd_ros.core.state import Array, Mode, State


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
    """

    kept = ("_last", "_u", "_followed")

    def __init__(self, field: ModeField, inner: Stepper, dt: float) -> None:
        self.field, self._transitions = field, Transitions(field, dt)
        self._inner: Any = inner
        self.system = field.system
        self.is_fixed = inner.is_fixed
        self.guards, self.switches = field.names, field.names[: len(field.mode)]
        self.ends_at_samples = inner.is_fixed and field.rows is not None
        self._search = StepEvents(field, inner)
        self._clearance = Clearance(self.system, dt)
        self._has_clearance = self._clearance.serves and not (field.surfaces or field.guards.names)
        if hasattr(inner, "stride") and self._has_clearance and self._clearance.is_whole:
            self.stride = self._stride
        self._last: State | None = None
        self._u: Array | None = None
        self._followed: Mode = ()

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
        happens = self._transitions
        kept: Margin | None = None
        while True:
            rest = min((rest.t for rest in happens.rests), default=math.inf)
            self.field.watch(x, u, happens.left)
            if after is None:
                longest = x.t + self.field.longest(x, u)
                after = self._inner.step(x, u, min(end, rest, longest))
            if after is x or not math.isfinite(after.v.dot(after.v)):  # the simulation says so
                return after
            after, margin = self._search.first(x, u, after, happens.left, kept)
            if after is not x:
                break
            assert margin is not None
            mode = self.field.mode
            x, after = self._follow(happens.happened(x, u, margin)), None
            kept = margin if self.field.mode == mode else None
            if happens.ended:
                return x
        after = self.field.onto(after, u)
        if happens.left:
            happens.left &= self.field.close(after, u)
        if margin is not None:
            after = happens.happened(after, u, margin)
        elif after.t >= rest:
            after = happens.rested(after)
        self._last = after
        self._clearance.room = 0.0
        if self._has_clearance and not (happens.left or happens.rests or self.field.on):
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

    @property
    def pace(self) -> tuple[float, ...]:
        """As `Stepper.pace`."""
        return self._inner.pace

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        """As `Stepper.pace`."""
        self._inner.pace = pace

    @property
    def ended(self) -> tuple[str, ...]:
        """Names of the guards that ended the phase in the last step."""
        return self._transitions.ended

    @property
    def events(self) -> EventLog:
        """What happened so far, but for what was taken."""
        return self._transitions.events

    def take_events(self) -> EventLog:
        """As `Stepper.take_events`."""
        taken, self._transitions.events = self.events, EventLog()
        return taken

    def memory(self) -> Memory:
        """Mode, events and the last step."""
        mode, known = self.field.mode, self._transitions.known
        more = {"room": self._clearance.known, "inner": self._inner.memory()}
        return {**super().memory(), "mode": mode, "transitions": known, **more}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        super().recall({name: memory[name] for name in self.kept}, x)
        self.field.mode = self._followed
        self._inner.follow(self.field.accelerator(), self._followed)
        self._inner.recall(memory["inner"], x)
        self._clearance.known = memory["room"]
        self._transitions.known = memory["transitions"]
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
        self._transitions.forget()
        self._followed = ()

    def _settled(self, x: State, u: Array | None) -> State:
        """The state with the mode of the next step, decided where anything has changed."""
        field, happens = self.field, self._transitions
        is_new = self._last is None or x.t != self._last.t  # otherwise the last one, corrected
        is_changed = not _same(u, self._u)
        if is_changed:
            self._u = None if u is None else u.copy()
        if is_new:
            x = happens.begun(field.inside(x), u)
            x = happens.happened(x, u, None) if happens.hits(x) else field.onto_rows(x)
        elif is_changed and (field.on or field.drives):
            before = x
            x = happens.decide(x, u, {*field.on, *field.near(x)})
            x = happens.switched(x._replace(mode=before.mode))
        elif ways := field.renamed(x, u):
            happens.change(ways)
        return self._follow(x)

    def _follow(self, x: State) -> State:
        """Let the inner method follow the mode."""
        field = self.field
        if self._followed != field.mode:
            self._followed = field.mode
            self._inner.follow(field.accelerator(), field.mode)
        return x if x.mode == field.mode else x._replace(mode=field.mode)


def _same(one: Array | None, other: Array | None) -> bool:
    """Whether commands are the same bits."""
    if one is None or other is None:
        return one is other
    return one.tobytes() == other.tobytes()
