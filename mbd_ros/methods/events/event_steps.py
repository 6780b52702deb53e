"""Steps of a smooth method from event to event: impacts, resets, the mode that follows."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contact_modes.event_rows import ExactRows
from mbd_ros.core.contact_modes.row_distances import rounding
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.nonsmooth.impact_map import Impact, ImpactMap
from mbd_ros.core.state import Array, Memory, Mode, State
from mbd_ros.errors import JammedError, SolveError
from mbd_ros.methods.events.clearance import Clearance
from mbd_ros.methods.events.mode_field import Margin, ModeField, decided
from mbd_ros.methods.events.step_events import Event, EventLog, StepEvents
from mbd_ros.methods.integration.stepping import Stepper

_APPROACH = 1.0e-6  # of the velocity: an approach that shows which way friction pushes
_MOST = 16  # events that may follow one another within a short time, besides two a switch
_MOST_BOUNCES = 10_000  # impacts that may: e = 0.999 needs thousands before it is at rest
_MOST_AT_ONCE = 100  # impacts that may follow one another at one time
_SHORT = 1.0e-3  # of dt: events this close to one another are counted


class Rest(NamedTuple):
    """The end of infinitely many bounces.

    Attributes:
        t: Time [s].
        row: Number of the gap among the exact rows.
    """

    t: float
    row: int


class Pace(NamedTuple):
    """How fast events follow one another.

    Attributes:
        t: Time of the last one [s].
        quick: How many have followed one another within a short time, since the last impact.
        bounces: How many impacts have.
    """

    t: float = -math.inf
    quick: int = 0
    bounces: int = 0

    def after(
        self, t: float, short: float, switches: int, names: Sequence[str], *, hits: bool
    ) -> Pace:
        """The pace after one more event.

        Args:
            t: Its time [s].
            short: Time that is short [s].
            switches: How many switches there are.
            hits: Whether it is an impact.

        Raises:
            SolveError: Events accumulate.
        """
        if t - self.t >= short:
            return Pace(t)
        pace = Pace(t, 0, self.bounces + 1) if hits else Pace(t, self.quick + 1, self.bounces)
        if pace.quick > _MOST + 2 * switches or pace.bounces > _MOST_BOUNCES:
            kind, count = ("impacts", pace.bounces) if hits else ("switching events", pace.quick)
            raise SolveError(
                f"t = {t:.9g} s: {count} {kind}, each within {short:.2g} s of the last "
                f"one, accumulate (Zeno) at {', '.join(names)}"
                + ("; a smaller dt lets more of them pass" if hits else "")
            )
        return pace


Known = tuple[frozenset[int], tuple[Rest, ...], Pace, EventLog]


class EventSteps(Stepper):
    """Steps that end where a switch of the system is reached or left.

    Each step is taken in one mode. At an event come impacts, all in one solve, and then the mode
    in which the motion goes on; the inner method follows it from the next step on, so that the
    dense output of the finished step keeps its own mode.

    Args:
        field: The system in its modes.
        inner: Steps of that system.
        dt: Step of a fixed-step method, and interval of the output [s].
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


class Transitions:
    """What happens at events, in the mode of a field; it is written down.

    Args:
        field: The system in its modes.
        dt: Step of a fixed-step method, and interval of the output [s].

    Attributes:
        left: Switches that the motion is just leaving, and guards that were zero just now.
        rests: Bounces that have not ended.
        events: What happened so far.
        ended: Names of the guards that end the phase, at the end of the last step.
    """

    def __init__(self, field: ModeField, dt: float) -> None:
        self._field, self._system, self._short = field, field.system, _SHORT * dt
        self._impacts: Impacts | None = None
        if field.rows is not None and field.gaps:
            self._impacts = Impacts(field.system, field.rows, field.gaps)
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self.ended: tuple[str, ...] = ()
        self.known = frozenset(), (), Pace(), EventLog()

    @property
    def known(self) -> Known:
        """What later events depend on, and those so far."""
        return self.left, self.rests, self._pace, self.events

    @known.setter
    def known(self, known: Known) -> None:
        self.left, self.rests, self._pace, self.events = known

    def happened(self, x: State, u: Array | None, margin: Margin | None) -> State:
        """The state after an event: impacts, then the mode that begins."""
        field, before = self._field, x
        if margin and (ways := field.renamed(x, u, margin)):
            self.change(ways)
            return field.onto_rows(x)._replace(mode=field.mode)
        switch, way = margin or (-1, 0)
        fired, impact = field.fired(x, u, switch), None
        if idle := field.idle(x, fired):
            self.left |= frozenset(idle)
            fired = [i for i in fired if i not in idle]
            if switch in idle and not fired:
                return x
        if ending := field.ending(fired):
            self.ended = tuple(field.names[i] for i in ending)
            return x
        if fired:
            x = self.begun(field.inside(field.reset(x, u, fired)), u)
            self.left |= frozenset(fired)
        hits = self.hits(x)
        if hits:
            x, impact = self._struck(x, u)
            self.left |= frozenset(fired)
        elif way and not fired:
            self.change(field.leaving(x, u, (switch, way)))
        elif margin and not fired:
            x = self.decide(x, u, {*field.on, switch, *field.near(x)})
        x = field.onto_rows(x)._replace(mode=field.mode)
        names = tuple(field.names[i] for i in sorted({switch, *hits, *fired} - {-1}))
        if not self.rests:
            given = (x.t, self._short, len(field.names), names)
            self._pace = self._pace.after(*given, hits=bool(hits))
        self._log(names, before, x, impact)
        return x

    def hits(self, x: State) -> list[int]:
        """Gaps that are closed and close further."""
        return [] if self._impacts is None else self._impacts.hits(x)

    def _struck(self, x: State, u: Array | None) -> tuple[State, Impact]:
        """The state after impacts, in its mode, and what they are together."""
        impacts, field = self._impacts, self._field
        assert impacts is not None
        x, impact = impacts.after(x)
        for _ in range(_MOST_AT_ONCE):
            if not impacts.hits(x):
                break
            x, more = impacts.after(x)  # a gap that was open by hardly more than rounding
            impact = Impact(more.v, impact.p + more.p, min(impact.share, more.share))
        x = self.begun(x, u)
        rests = impacts.rests(x, u, field.mode)
        if rests:
            self.rests = (*self.rests, *rests)
            self.change({rest.row: 0 for rest in rests})
            x = self.begun(field.onto_rows(x), u)
        return x, impact

    def rested(self, x: State) -> State:
        """The state in which gaps are at rest whose bounces have ended."""
        over = sorted({rest.row for rest in self.rests if rest.t <= x.t})
        self.rests = tuple(rest for rest in self.rests if rest.t > x.t)
        self._log(tuple(self._field.names[i] for i in over), x, x, None)
        return x

    def _log(
        self, names: tuple[str, ...], before: State, after: State, impact: Impact | None
    ) -> None:
        impulse, share = np.zeros(len(self._system.multiplier_rows)), 1.0
        if impact is not None:
            impulse, share = impact.p, impact.share
        expand = self._system.expand
        event = Event(after.t, names, expand(before), expand(after), impulse, share)
        self.events = self.events.after(event)

    def begun(self, x: State, u: Array | None) -> State:
        """The state with the mode that heights and accelerations say."""
        field = self._field
        field.begin(x)
        self.left = frozenset(field.close(x, u))
        return self.decide(x, u, field.near(x))

    def decide(self, x: State, u: Array | None, on: Collection[int]) -> State:
        """The state in the modes in which switches go on, after impulses where friction jams."""
        try:
            ways = self.decided(x, u, on)
        except JammedError:
            x = self._jammed(x, u)
            ways = self.decided(x, u, self._field.near(x))
        self.change(ways)
        return x._replace(mode=self._field.mode)

    def _jammed(self, x: State, u: Array | None) -> State:
        """The state after an impulse without collision, at its heights."""
        field, impacts = self._field, self._impacts
        assert impacts is not None
        slipping = impacts.slipping(x)
        after, impact = impacts.without_collision(x, u, slipping)
        field.begin(after)
        self.left = frozenset(field.close(after, u))
        self._log(tuple(field.names[i] for i in slipping), x, after, impact)
        return after

    def decided(self, x: State, u: Array | None, on: Collection[int]) -> dict[int, int]:
        """Modes in which switches go on."""
        try:
            return decided(self._field, x, u, on)
        except SolveError as error:
            pace, zeno = self._pace, ""
            if x.t - pace.t < self._short and pace.quick >= 2 * len(self._field.names):
                zeno = f"; the last {pace.quick} switching events accumulate there (Zeno)"
            raise type(error)(f"t = {x.t:.9g} s: {error}{zeno}") from error

    def change(self, ways: dict[int, int]) -> None:
        """Switch to another mode; switches that are off are being left."""
        field = self._field
        field.mode = tuple(ways.get(i, way) for i, way in enumerate(field.mode))
        self.left |= frozenset(i for i, way in ways.items() if way)
        self.left -= frozenset(i for i, way in ways.items() if not way)

    def switched(self, x: State) -> State:
        """The state in another mode, which inputs that jump have begun."""
        pairs = zip(self._field.names, x.mode, self._field.mode, strict=True)
        names = tuple(name for name, one, other in pairs if one != other)
        after = x._replace(mode=self._field.mode)
        if names:
            self._log(names, x, after, None)
        return after


class Impacts:
    """Impacts of the gaps of one system.

    Args:
        rows: Its exact rows.
        gaps: Numbers of those that are gaps.
    """

    def __init__(self, system: System, rows: ExactRows, gaps: Sequence[int]) -> None:
        self._system, self._rows, self._gaps = system, rows, tuple(gaps)
        self._level = ImpactMap(system)

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
