"""Steps of a smooth method from event to event: impacts, resets, and the mode that follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contact_modes.event_rows import EventRows
from mbd_ros.core.contact_modes.row_distances import Distances, rounding
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.nonsmooth.impact_map import Impact, ImpactMap
from mbd_ros.core.state import Array, Memory, Mode, State, have_same_bits
from mbd_ros.errors import JammedError, SolveError
from mbd_ros.methods.events.clearance import Clearance
from mbd_ros.methods.events.mode_field import Margin, ModeField, decide_modes
from mbd_ros.methods.events.step_events import Event, EventLog, StepSearch
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
        row: Number of the gap among the event-driven rows.
    """

    t: float
    row: int


class Accumulation(NamedTuple):
    """Counts of events that follow one another quickly, by which accumulation (Zeno) is found.

    Attributes:
        t: Time of the last event [s].
        quick: Number of events within a short time of one another, since the last impact.
        bounces: Number of impacts within a short time of one another.
    """

    t: float = -math.inf
    quick: int = 0
    bounces: int = 0

    def after(
        self, t: float, short: float, switches: int, names: Sequence[str], *, hits: bool
    ) -> Accumulation:
        """Return the counts after one more event.

        Args:
            t: Time of the event [s].
            short: Time between events that is short [s].
            switches: Number of switches.
            names: Names of the guards of the event.
            hits: Whether it is an impact.

        Raises:
            SolveError: Events accumulate.
        """
        if t - self.t >= short:
            return Accumulation(t)
        quick, bounces = (0, self.bounces + 1) if hits else (self.quick + 1, self.bounces)
        if quick > _MOST + 2 * switches or bounces > _MOST_BOUNCES:
            kind, count = ("impacts", bounces) if hits else ("switching events", quick)
            raise SolveError(
                f"t = {t:.9g} s: {count} {kind}, each within {short:.2g} s of the last "
                f"one, accumulate (Zeno) at {', '.join(names)}"
                + ("; a smaller dt lets more of them pass" if hits else "")
            )
        return Accumulation(t, quick, bounces)


Checkpoint = tuple[frozenset[int], tuple[Rest, ...], Accumulation, EventLog]


class EventSteps(Stepper):
    """Steps that end where a switch of the system is reached or left.

    Each step is taken in one mode. At an event come impacts, all in one solve, and then the mode
    in which the motion goes on; the inner method follows it from the next step on, so that the
    dense output of the finished step keeps its own mode.

    Args:
        field: The switches of the system.
        inner: Steps of that system.
        dt: Step of a fixed-step method, and interval of the output [s].

    Attributes:
        mode: Mode in which the next step goes on.
    """

    checkpoint_fields = ("_last", "_u", "_followed", "mode")

    def __init__(self, field: ModeField, inner: Stepper, dt: float) -> None:
        self.field = field
        self._transitions = Transitions(field, dt)
        self._inner: Any = inner
        self.system = field.system
        self.is_fixed = inner.is_fixed
        self.guards = field.names
        self.switches = field.switches
        self.ends_at_samples = inner.is_fixed and field.rows is not None
        self._clearance = Clearance(self.system, dt)
        self._has_clearance = self._clearance.serves and not (field.surfaces or field.guards.names)
        self.can_stride = inner.can_stride and self._has_clearance and self._clearance.is_whole
        self._last: State | None = None
        self._u: Array | None = None
        self._followed: Mode = ()
        self.mode: Mode = ()

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of the inner method, or to the next event.

        Raises:
            SolveError: The solution is not unique or ends, or events accumulate.
            DivergedError: The inner method diverges.
        """
        if self._clearance.room > 0.0 and x is self._last and have_same_bits(u, self._u):
            after = self._inner.step(x, u, end)
            if self._clearance.passes(x, after):
                self._last = after
                return after
            return self._search(x, u, end, after)
        if not x.t < end:
            return x
        return self._search(self._settle(x, u), u, end)

    def stride(
        self,
        x: State,
        u: Array | None,
        end: float,
        most: int,
        watch: Callable[[Array], bool] | None = None,
    ) -> tuple[State, int]:
        """Advance by several steps at once while no stop is near."""
        clearance = self._clearance
        if not (clearance.room > 0.0 and x is self._last and have_same_bits(u, self._u)):
            return self.step(x, u, end), 1
        after, count = self._inner.stride(x, u, end, most, clearance.comes_near)
        if clearance.is_clear(after):
            self._last = after
            return after, count
        return self._search(self._inner.began(), u, end, after), count

    def _search(self, x: State, u: Array | None, end: float, after: State | None = None) -> State:
        """Return the state after a step, or after the first event in it.

        Args:
            x: State to start from, in its mode.
            u: Inputs held in the step.
            end: Time that the step does not go beyond [s].
            after: State after the step where it was taken already.
        """
        field, transitions = self.field, self._transitions
        ineffective: Margin | None = None
        while True:
            rest = min((rest.t for rest in transitions.rests), default=math.inf)
            sides = field.guard_sides(x, u, x.mode, transitions.left)
            search = StepSearch(field, self._inner, x, u, transitions.left, sides)
            if after is None:
                longest = x.t + field.longest_step(x, u, x.mode)
                after = self._inner.step(x, u, min(end, rest, longest))
            if after is x or not math.isfinite(after.v.dot(after.v)):  # the simulation refuses it
                return after
            after, margin = search.first(after, ineffective)
            if after is not x:
                break
            assert margin is not None
            mode = x.mode
            x, after = self._follow(transitions.happen(x, u, margin, search.sides)), None
            ineffective = margin if x.mode == mode else None
            if transitions.ended:
                return x
        after = field.project(after, u, x.mode)
        if transitions.left:
            transitions.left &= field.close(after, u, x.mode)
        if margin is not None:
            after = transitions.happen(after, u, margin, search.sides)
        elif after.t >= rest:
            after = transitions.end_bounces(after)
        self._last = after
        self.mode = after.mode
        self._clearance.room = 0.0
        if self._has_clearance and not (
            transitions.left or transitions.rests or field.active(after.mode)
        ):
            self._clearance.measure(after)
        return after

    def settle(self, x: State, u: Array | None) -> State:
        """Return the state with the mode in which it goes on."""
        self._last = x = self._settle(x, u)
        return x

    def restart(self) -> None:
        """Forget mode, events and earlier steps."""
        self._inner.restart()
        self._last = self._u = None
        self._clearance.room = 0.0
        self._transitions.restart()
        self._followed = ()

    @property
    def pace(self) -> tuple[float, ...]:
        """Length of the next step [s] and last error, where the method chooses its steps."""
        return self._inner.pace

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        """Go on with the pace of other steps of the same method."""
        self._inner.pace = pace

    @property
    def ended(self) -> tuple[str, ...]:
        """Names of the guards that ended the phase in the last step."""
        return self._transitions.ended

    @property
    def events(self) -> EventLog:
        """Events so far, but for those that were taken."""
        return self._transitions.events

    def take_events(self) -> EventLog:
        """Return the events since the start or the last call, and forget them."""
        taken, self._transitions.events = self.events, EventLog()
        return taken

    def checkpoint(self) -> Memory:
        """Return mode, events and the last step."""
        return {
            **super().checkpoint(),
            "transitions": self._transitions.checkpoint(),
            "room": self._clearance.known,
            "inner": self._inner.checkpoint(),
        }

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Go on as after the step at which a checkpoint was taken, with the same bits."""
        super().restore({name: checkpoint[name] for name in self.checkpoint_fields}, x)
        self._inner.follow(self.field.accelerator(self._followed), self._followed)
        self._inner.restore(checkpoint["inner"], x)
        self._clearance.known = checkpoint["room"]
        self._transitions.restore(checkpoint["transitions"])

    def continue_from(self, x: State) -> None:
        """Continue in the same mode from a corrected state."""
        if self._last is not None:
            self._clearance.moved(self._last, x)
        self._last = x
        self._inner.continue_from(x)

    def interpolate(self, t: float) -> State:
        """Return the state at a time inside the last step, on what was active in it."""
        if self._last is not None and t == self._last.t:
            return self._last
        return self.field.project(self._inner.interpolate(t), self._u, self._followed)

    def _settle(self, x: State, u: Array | None) -> State:
        """Return the state with the mode of the next step, decided where anything has changed."""
        field, transitions = self.field, self._transitions
        is_new = self._last is None or x.t != self._last.t  # otherwise the last one, corrected
        is_changed = not have_same_bits(u, self._u)
        if is_changed:
            self._u = None if u is None else u.copy()
        if is_new:
            x = transitions.begin(field.open_gaps(x), u)
            if transitions.hits(x):
                return self._follow(transitions.happen(x, u, None))
            return self._follow(field.project_rows(x, x.mode))
        if x.mode != self.mode:
            x = x._replace(mode=self.mode)
        if is_changed and (field.active(x.mode) or field.drives(x.mode)):
            mode = x.mode
            x = transitions.decide(x, u, mode, {*field.active(mode), *field.near(x)})
            transitions.log_switches(x._replace(mode=mode), x.mode)
        elif entries := field.renamed_slips(x, u, x.mode):
            x = transitions.switch(x, entries)
        return self._follow(x)

    def _follow(self, x: State) -> State:
        """Let the inner method follow the mode of a state."""
        self.mode = x.mode
        if self._followed != x.mode:
            self._followed = x.mode
            self._inner.follow(self.field.accelerator(x.mode), x.mode)
        return x


class Transitions:
    """Transitions between modes at events, and the log of these events.

    Args:
        field: The switches of the system.
        dt: Step of a fixed-step method, and interval of the output [s].

    Attributes:
        left: Switches that the motion is just leaving, and guards that were zero just now.
        rests: Bounces that have not ended.
        events: Events so far.
        ended: Names of the guards that end the phase, at the end of the last step.
    """

    def __init__(self, field: ModeField, dt: float) -> None:
        self._field = field
        self._system = field.system
        self._short = _SHORT * dt
        self._impacts: Impacts | None = None
        if field.rows is not None and field.gaps:
            self._impacts = Impacts(field.system, field.rows, field.gaps)
        self.restart()

    def restart(self) -> None:
        """Forget all events."""
        self.ended: tuple[str, ...] = ()
        self.restore((frozenset(), (), Accumulation(), EventLog()))

    def checkpoint(self) -> Checkpoint:
        """Return what later events depend on, and the events so far."""
        return self.left, self.rests, self._accumulation, self.events

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self.left, self.rests, self._accumulation, self.events = checkpoint

    def happen(
        self, x: State, u: Array | None, margin: Margin | None, sides: tuple[int, ...] = ()
    ) -> State:
        """Return the state after an event: impacts, then the mode that begins.

        Args:
            x: State at the event, with the mode that ends.
            u: Inputs there.
            margin: The margin that is zero; None for an impact where a motion begins.
            sides: Sides on which guards of parts act in the step that ends, as
                `ModeField.guard_sides`.
        """
        field, before, mode = self._field, x, x.mode
        if margin and (entries := field.renamed_slips(x, u, mode, margin)):
            x = self.switch(x, entries)
            return field.project_rows(x, x.mode)
        switch, side = margin or (-1, 0)
        fired, impact = field.fired(x, u, mode, sides, switch), None
        if idle := field.idle_guards(x, fired):
            self.left |= frozenset(idle)
            fired = [i for i in fired if i not in idle]
            if switch in idle and not fired:
                return x
        if ending := field.ending_guards(fired):
            self.ended = tuple(field.names[i] for i in ending)
            return x
        if fired:
            x = self.begin(field.open_gaps(field.reset(x, u, fired)), u)
            self.left |= frozenset(fired)
        hits = self.hits(x)
        if hits:
            x, impact = self._hit(x, u)
            self.left |= frozenset(fired)
        elif side and not fired:
            x = self.switch(x, field.modes_after(x, u, mode, (switch, side)))
        elif margin and not fired:
            x = self.decide(x, u, mode, {*field.active(mode), switch, *field.near(x)})
        x = field.project_rows(x, x.mode)
        names = tuple(field.names[i] for i in sorted({switch, *hits, *fired} - {-1}))
        if not self.rests:
            self._accumulation = self._accumulation.after(
                x.t, self._short, len(field.names), names, hits=bool(hits)
            )
        self._log(names, before, x, impact)
        return x

    def hits(self, x: State) -> list[int]:
        """Return the gaps that are closed and close further."""
        return [] if self._impacts is None else self._impacts.hits(x)

    def _hit(self, x: State, u: Array | None) -> tuple[State, Impact]:
        """Return the state after impacts, in its mode, and their sum."""
        impacts, field = self._impacts, self._field
        assert impacts is not None
        x, impact = impacts.after(x)
        for _ in range(_MOST_AT_ONCE):
            if not impacts.hits(x):
                break
            x, more = impacts.after(x)  # a gap that was open by hardly more than rounding
            impact = Impact(more.v, impact.p + more.p, min(impact.share, more.share))
        x = self.begin(x, u)
        rests = impacts.rests(x, u, x.mode)
        if rests:
            self.rests = (*self.rests, *rests)
            x = self.switch(x, {rest.row: 0 for rest in rests})
            x = self.begin(field.project_rows(x, x.mode), u)
        return x, impact

    def end_bounces(self, x: State) -> State:
        """Return the state in which gaps are at rest whose bounces have ended."""
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

    def begin(self, x: State, u: Array | None) -> State:
        """Return the state with the mode that distances and accelerations say."""
        mode, close, near = self._field.begin(x, u)
        self.left = frozenset(close)
        return self.decide(x, u, mode, near)

    def decide(self, x: State, u: Array | None, mode: Mode, undecided: Collection[int]) -> State:
        """Return the state in the mode in which it goes on, after impulses where friction jams.

        Args:
            x: State, with the mode that ends.
            u: Inputs there.
            mode: Mode of the switches that are decided already.
            undecided: Numbers of the others.
        """
        try:
            entries = self._decided(x, u, mode, undecided)
        except JammedError:
            x, mode, near = self._release(x, u)
            entries = self._decided(x, u, mode, near)
        return self.switch(x._replace(mode=mode), entries)

    def _release(self, x: State, u: Array | None) -> tuple[State, Mode, set[int]]:
        """Return the state after an impulse without collision, its mode and undecided switches."""
        field, impacts = self._field, self._impacts
        assert impacts is not None
        slipping = impacts.slipping(x)
        after, impact = impacts.without_collision(x, u, slipping)
        mode, close, near = field.begin(after, u)
        self.left = frozenset(close)
        self._log(tuple(field.names[i] for i in slipping), x, after, impact)
        return after, mode, near

    def _decided(
        self, x: State, u: Array | None, mode: Mode, undecided: Collection[int]
    ) -> dict[int, int]:
        """Return the modes in which undecided switches go on."""
        try:
            return decide_modes(self._field, x, u, mode, undecided)
        except SolveError as error:
            recent, zeno = self._accumulation, ""
            if x.t - recent.t < self._short and recent.quick >= 2 * len(self._field.names):
                zeno = f"; the last {recent.quick} switching events accumulate there (Zeno)"
            raise type(error)(f"t = {x.t:.9g} s: {error}{zeno}") from error

    def switch(self, x: State, entries: Mapping[int, int]) -> State:
        """Return the state in another mode; switches that are off then are being left."""
        mode = tuple(entries.get(i, side) for i, side in enumerate(x.mode))
        self.left |= frozenset(i for i, side in entries.items() if side)
        self.left -= frozenset(i for i, side in entries.items() if not side)
        return x._replace(mode=mode)

    def log_switches(self, before: State, mode: Mode) -> None:
        """Log the switches that inputs which jump have moved to another mode."""
        pairs = zip(self._field.names, before.mode, mode, strict=False)
        names = tuple(name for name, old, new in pairs if old != new)
        if names:
            self._log(names, before, before._replace(mode=mode), None)


class Impacts:
    """Impacts of the gaps of one system.

    Args:
        system: The system.
        rows: Its event-driven rows.
        gaps: Numbers of those that are gaps.
    """

    def __init__(self, system: System, rows: EventRows, gaps: Sequence[int]) -> None:
        self._system = system
        self._rows = rows
        self._gaps = tuple(gaps)
        self._impact_map = ImpactMap(system)

    def closed(self, y: State) -> list[int]:
        """Return the gaps that are closed to within rounding."""
        return self._closed(y, self._rows.measure(y))

    def _closed(self, y: State, measured: Distances) -> list[int]:
        slack = rounding(y)
        return [i for i in self._gaps if measured.distances[i] <= slack]

    def hits(self, y: State) -> list[int]:
        """Return the gaps that are closed and close further."""
        measured, slack = self._rows.measure(y), rounding(y)
        closed = self._closed(y, measured)
        if not closed:
            return []
        rate = self._rows.rates(y, measured)
        return [i for i in closed if rate[i] < -slack]

    def after(self, y: State) -> tuple[State, Impact]:
        """Return the state after the impacts of all gaps that are closed, and the impact.

        Raises:
            SolveError: Nothing can keep a gap from closing further.
        """
        rows, closed = self._rows, self.closed(y)
        mode = tuple(0 if i in closed else 1 for i in range(len(rows.names)))
        y = rows.project(y, mode, moves=False)
        x = self._system.expand(y)
        impact = self._impact_map.impact(x, rows.slots[closed].tolist())
        return y._replace(v=self._system.reduce(x._replace(v=impact.v)).v), impact

    def slipping(self, y: State) -> list[int]:
        """Return the normals of contacts that are closed and slip."""
        return self._rows.slipping_contacts(y, self.closed(y))

    def without_collision(
        self, y: State, u: Array | None, slipping: Sequence[int]
    ) -> tuple[State, Impact]:
        """Return the state after an impulse that ends slips which friction has jammed.

        Where no acceleration is consistent, normal forces grow without bound, and within no time
        an impulse ends the slips that cause it: that of an impact with an approach close to zero,
        without restitution. Source: F. Génot, B. Brogliato, Eur. J. Mech. A 18, 1999, sec. 5; D.
        Stewart, SIAM Review 42, 2000, sec. 3, on the limit of short steps.

        Args:
            y: State of what is integrated.
            u: Inputs there.
            slipping: Normals of the contacts that slip.

        Raises:
            SolveError: No impulse does.
        """
        rows, system, closed = self._rows, self._system, self.closed(y)
        J, _, response, _, _ = rows.response(y, u, slipping)
        x = system.expand(y)
        approach = -_APPROACH * float(np.linalg.norm(x.v)) * np.linalg.norm(J, axis=1)
        nudge = np.linalg.lstsq(J.dot(response), approach - J.dot(x.v), rcond=1.0e-13)[0]
        before = x._replace(v=x.v + response.dot(nudge))
        impact = self._impact_map.impact(before, rows.slots[closed].tolist(), expands=False)
        after = system.reduce(x._replace(v=impact.v))
        if not system.energy(y._replace(v=after.v)) < system.energy(y):
            raise SolveError("no impulse without collision ends it")
        impact.p[rows.slots[list(slipping)]] += nudge
        return y._replace(v=after.v), impact

    def rests(self, y: State, u: Array | None, mode: Mode) -> list[Rest]:
        """Return closed gaps that would open by no more than rounding, and when they rest.

        A gap that opens with v while its acceleration is -a bounces for 2 v / (a (1 - e)) more,
        by v^2 / (2 a) at most.

        Args:
            y: State after an impact.
            u: Inputs there.
            mode: Mode in which it goes on otherwise.
        """
        rows, rests = self._rows, list[Rest]()
        measured, slack = rows.measure(y), rounding(y)
        rate = rows.rates(y, measured)
        opening = [i for i in self._closed(y, measured) if mode[i] and rate[i] > 0.0]
        w = rows.row_accelerations(y, u, mode) if opening else rate
        for i in (i for i in opening if w[i] < 0.0):
            v, a, e = float(rate[i]), -float(w[i]), float(rows.restitution[i])
            if e < 1.0 and v * v <= 2.0 * a * slack:
                rests.append(Rest(y.t + 2.0 * v / (a * (1.0 - e)), i))
        return rests
