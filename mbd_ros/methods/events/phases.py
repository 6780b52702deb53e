"""Phases of a motion: their constraints, their exits, and resets at the exits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contact_modes.row_distances import rounding
from mbd_ros.core.contracts import Guard, Now, Part, label
from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.nonsmooth.impact_map import ImpactMap
from mbd_ros.core.state import Array, Memory, State
from mbd_ros.core.thresholds import ASSEMBLED
from mbd_ros.errors import SolveError
from mbd_ros.methods.events.crossings import Condition, Crossing
from mbd_ros.methods.events.step_events import Event, EventLog
from mbd_ros.methods.integration.stepping import Stepper

Slots = NDArray[np.intp]
_SLACK = 1.0e-9  # of the largest impulse
_MOST_AT_ONCE = 100  # phases that may follow one another at one time


class Phase(NamedTuple):
    """A phase of the motion between two events.

    Attributes:
        name: Unique in the scene.
        exits: What ends it, in the order of the scene: the first one that fires decides.
        checks: What may not happen in it.
        demands: What holds where it begins: the checks, and what exits wait for instead.
        limit: Longest time in it [s], beyond which no guard is waited for; inf without one.
    """

    name: str
    exits: tuple[Exit, ...]
    checks: tuple[Check, ...]
    demands: tuple[Check, ...]
    limit: float


class Exit(NamedTuple):
    """A way out of a phase.

    Attributes:
        name: Of its guard, unique in the phase.
        crossing: The number whose zero ends the phase; None where a time does.
        direction: 1 where it acts on the way up, -1 on the way down, 0 both ways.
        condition: Where it acts; None for everywhere.
        after: Time in the phase after which it acts [s]; None where a crossing does.
        then: Number of the next phase.
        reset: What happens at once.
    """

    name: str
    crossing: Crossing | None
    direction: int
    condition: Condition | None
    after: float | None
    then: int
    reset: PhaseReset


class Check(NamedTuple):
    """A number that stays positive in a phase, or the motion ends with an error.

    Attributes:
        name: Of its guard.
        contact: Whose number it is.
        failure: What it means that it does not.
    """

    name: str
    contact: str
    crossing: Crossing
    failure: str


class PhaseReset:
    """A jump of a state; a function of the state alone.

    The impact comes first, all of its rows in one solve, and what the old phase held lets go
    without an impulse. Joints are relabelled then.

    Args:
        size: Number of multipliers of the scene.
        striking: The system of the impact: rows that hold, bilateral, and contacts that bounce;
            None without an impact.
        slots: Where the multipliers of that system stand among those of the scene.
        touching: Slots in that system of contacts that bounce.
        relabelling: Joints under other names; None where they keep theirs.
        demands: Of the impulses of that system.
    """

    def __init__(
        self,
        size: int,
        striking: System | None,
        slots: Slots,
        touching: tuple[int, ...],
        relabelling: Relabelling | None,
        demands: Sequence[Demand] = (),
    ) -> None:
        self._size, self._slots, self._touching = size, slots, touching
        self.demands = tuple(demands)
        self.striking, self.relabelling = striking, relabelling
        self._level = None if striking is None else ImpactMap(striking)

    def after(self, x: State) -> Struck:
        """Return the state of all joints after it.

        Args:
            x: State of all joints before it.

        Raises:
            SolveError: Nothing can keep a contact from closing further, or one that is held would
                pull or slip; names it.
        """
        impulse, share = np.zeros(self._size), 1.0
        if self._level is not None:
            result = self._level.impact(x, self._touching)
            impulse[self._slots], share = result.p, result.share
            x = x._replace(v=result.v)
            if not self._touching:  # what rounding leaves where masses are very unequal
                result = self._level.impact(x, ())
                impulse[self._slots] += result.p
                x = x._replace(v=result.v)
            self._refuse_unheld(x, impulse[self._slots])
        if self.relabelling is not None:
            x = self.relabelling.after(x)
        return Struck(x, impulse, share)

    def _refuse_unheld(self, x: State, p: Array) -> None:
        """Refuse impulses that a contact which is held cannot exert."""
        assert self.striking is not None
        slack = _SLACK * float(np.abs(p).max(initial=0.0))
        for _, crossing, failure in self.demands:
            self.striking.k.refresh(x.q, x.v, crossing.reads)
            if crossing.value(self.striking.k, x, p) < -slack:
                raise SolveError(f"t = {x.t:.9g} s, impact: {failure}")


class Demand(NamedTuple):
    """A condition on the impulses of a held contact.

    Attributes:
        crossing: A number that may not be negative.
        failure: What it means that it is.
    """

    contact: str
    crossing: Crossing
    failure: str


class Struck(NamedTuple):
    """Result of an impact.

    Attributes:
        x: State of all joints after it.
        impulse: One a multiplier of the scene [N·s or N·m·s], shape (m,).
        share: Of the restitution that was given back.
    """

    x: State
    impulse: Array
    share: float = 1.0


class Relabelling(NamedTuple):
    """Joints and internal states under other names: q+ = A q + b, v+ = A v, z+ = B z.

    Attributes:
        q: Indices of some joints in a configuration, shape (n,).
        v: Their indices in a velocity, shape (n,).
        A: Shape (n, n).
        b: [rad or m], shape (n,).
        z: Indices of some internal states, shape (m,).
        B: Shape (m, m).
    """

    q: Slots
    v: Slots
    A: Array
    b: Array
    z: Slots
    B: Array

    def after(self, x: State) -> State:
        """Return the state under the new names."""
        q, v, z = x.q.copy(), x.v.copy(), x.z.copy()
        q[self.q] = self.A.dot(x.q[self.q]) + self.b
        v[self.v] = self.A.dot(x.v[self.v])
        z[self.z] = self.B.dot(x.z[self.z])
        return x._replace(q=q, v=v, z=z)


class PhaseGuards(Part):
    """The guards of a phase, for the events of its steps: exits first, then checks.

    Args:
        name: Of the phase.
        exits: Its exits; those by time are none of its guards.
    """

    def __init__(self, name: str, exits: Sequence[Exit], checks: Sequence[Check]) -> None:
        self.name = name
        crossed = [
            (phase_exit.crossing, phase_exit)
            for phase_exit in exits
            if phase_exit.crossing is not None
        ]
        self._crossings: list[Crossing] = [crossing for crossing, _ in crossed]
        self._crossings += [check.crossing for check in checks]
        self.guards = (
            *(_guard(phase_exit) for _, phase_exit in crossed),
            *(Guard(check.name, -1, ends=True) for check in checks),
        )
        self.reads = max(
            (phase_exit.reads for phase_exit in self._crossings), default=Reads.NOTHING
        )

    def guard_values(self, k: Kinematics, x: State, u: Array, now: Now) -> Array:
        """Return the numbers of exits and checks, shape (n,)."""
        return np.array([one.value(k, x, now.lam) for one in self._crossings])


def _guard(phase_exit: Exit) -> Guard:
    condition = None if phase_exit.condition is None else phase_exit.condition.holds
    return Guard(phase_exit.name, phase_exit.direction, condition=condition, ends=True)


class PhaseSteps(Stepper):
    """Steps in one phase after the other, each by steps of its own from event to event.

    Where a guard that ends the phase is zero, the first exit in the order of the scene that fires
    says what is reset and which phase follows. That is one event. A phase that begins decides
    anew in which mode it goes on, impacts of contacts that belong to no phase included.

    Args:
        system: The systems of the phases.
        build_stepper: Makes the steps of a system.

    Attributes:
        phases: What ends each, and what follows.
        now: Number of the phase.
        since: When it began [s].
    """

    now: int
    since: float
    checkpoint_fields = ("now", "since", "events_so_far", "_stepped", "_last", "_at_once")

    def __init__(
        self,
        system: PhasedSystem,
        build_stepper: Callable[[Any], Stepper],
    ) -> None:
        self.system = system
        phases: tuple[Phase, ...] = system.phases
        self.phases = phases
        self._stepper_of = build_stepper
        self._steppers = [build_stepper(phase_exit) for phase_exit in system.systems]
        self._used = set[int]()
        self.is_fixed = self.ends_at_samples = self._steppers[0].is_fixed
        timed = (label(p, e.name) for p in phases for e in p.exits if e.after is not None)
        named = (name for stepper in self._steppers for name in stepper.guards)
        silent = {label(p, check.name) for p in phases for check in p.checks}
        every = dict.fromkeys((*named, *timed))
        self.guards = tuple(name for name in every if name not in silent)
        self.switches = ("phase", *system.switches)
        self.restart()

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step, which ends where the phase does.

        Raises:
            SolveError: As the steps in a phase; or a contact that is held would open or slip, no
                guard has fired within the limit of the phase, or what a reset leaves breaks what
                holds in the next one.
        """
        phase, inner = self.phases[self.now], self._steppers[self.now]
        y = self._inward(x)
        timed = [e for e in phase.exits if e.after is not None]
        due = self.since + min((float(e.after or 0.0) for e in timed), default=math.inf)
        over = self.since + phase.limit
        self._stepped = self.now
        most = min(due, over)
        after = inner.step(y, u, min(end, most)) if y.t < most else y
        self._collect()
        if not math.isfinite(after.v.dot(after.v)):
            return after
        fired = list(inner.ended)
        fired += [label(phase, e.name) for e in timed if after.t >= self.since + (e.after or 0.0)]
        if fired:
            return self._ended(after, u, fired)
        if after.t >= over:
            names = ", ".join(one.name for one in phase.exits)
            raise SolveError(
                f"phase {phase.name} began at t = {self.since:.9g} s and none of its guards "
                f"({names}) has fired within its limit of {phase.limit:g} s"
            )
        return self._outward(after)

    def settle(self, x: State, u: Array | None) -> State:
        """Return the first state with its mode, in the phase of the state."""
        self.now = self._stepped = self.system.phase(x)
        self.since = x.t
        self._used.add(self.now)
        y = self._steppers[self.now].settle(self.system.inward(x), u)
        self._collect()
        self._refuse_unheld(y, u)
        return self._outward(y)

    def restart(self) -> None:
        """Forget all earlier steps, and begin in the first phase."""
        for stepper in self._steppers:
            stepper.restart()
        self.now = self._stepped = self.system.first
        self.since, self._at_once = 0.0, 0
        self._last, self.events_so_far = _Pair(), EventLog()

    @property
    def events(self) -> EventLog:
        """Events so far."""
        return self.events_so_far

    def take_events(self) -> EventLog:
        """Return the events since the start or the last call, and forget them."""
        taken, self.events_so_far = self.events_so_far, EventLog()
        return taken

    def checkpoint(self) -> Memory:
        """Return a checkpoint with those of the steps in all phases so far."""
        known = {i: self._steppers[i].checkpoint() for i in self._used}
        return {**super().checkpoint(), "steppers": known}

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Go on as after the step at which a checkpoint was taken."""
        super().restore({name: checkpoint[name] for name in self.checkpoint_fields}, x)
        y, known = self._inward(x), checkpoint["steppers"]
        for i in self._used - set(known):  # what is forgotten leaves a trace in their rounding
            self._steppers[i] = self._stepper_of(self.system.systems[i])
        self._used = set(known)
        for i in known:
            self._steppers[i].restore(known[i], y)

    def continue_from(self, x: State) -> None:
        """Continue from a corrected state, history kept."""
        y = self.system.inward(x)
        self._last = _Pair(x, y)
        self._steppers[self.now].continue_from(y)

    def interpolate(self, t: float) -> State:
        """Return the state at a time inside the last step, in the phase of that step."""
        last = self._last.outer
        if last is not None and t == last.t:
            return last
        return self.system.outward(self._stepped, self._steppers[self._stepped].interpolate(t))

    def _ended(self, y: State, u: Array | None, fired: Sequence[str]) -> State:
        """Return the state in the next phase."""
        system, old = self.system, self.now
        phase = self.phases[old]
        phase_exit = next((e for e in phase.exits if label(phase, e.name) in fired), None)
        if phase_exit is None:
            failed = next(one for one in phase.checks if label(phase, one.name) in fired)
            raise SolveError(f"t = {y.t:.9g} s, phase {phase.name}: {failed.failure}")
        before = system.systems[old].expand(y)
        struck = phase_exit.reset.after(before)
        self._count(y.t)
        self.now, self.since = phase_exit.then, y.t
        after = self._entered(struck.x, u, phase, phase_exit)
        outer = self._outward(after)
        failures = {label(phase, check.name) for check in phase.checks}
        names = tuple(name for name in fired if name not in failures)
        expand = system.systems[self.now].expand
        sides = (
            system.outward(old, before),
            system.outward(self.now, expand(after)),
        )
        event = Event(y.t, names, *sides, struck.impulse, struck.share, True)
        self.events_so_far = self.events_so_far.after(event)
        self._collect()
        self._refuse_unheld(after, u)
        return outer

    def _entered(self, x: State, u: Array | None, phase: Phase, phase_exit: Exit) -> State:
        """Return the first state of the phase that has just become the present one."""
        new, inner = self.phases[self.now], self._steppers[self.now]
        system = self.system.systems[self.now]
        y = system.reduce(x._replace(mode=()))
        refuse_open(system, y, f"{label(phase, phase_exit.name)} leads to phase {new.name}")
        pace = self._steppers[self._stepped].pace
        inner.restart()
        self._used.add(self.now)
        y = inner.settle(y, u)
        if pace and inner.pace:
            inner.pace = pace
        return y

    def _refuse_unheld(self, y: State, u: Array | None) -> None:
        """Refuse a phase in which a contact that is held would open or slip from the start."""
        phase = self.phases[self.now]
        if not phase.demands:
            return
        system = self.system.systems[self.now]
        x, k = system.expand(y), system.k
        now = system.evaluate(x, u)
        for check in phase.demands:
            k.refresh(x.q, x.v, check.crossing.reads)
            if check.crossing.value(k, x, now.lam) < -rounding(y):
                raise SolveError(f"t = {y.t:.9g} s, phase {phase.name}: {check.failure}")

    def _collect(self) -> None:
        """Take the events of the steps in the phase."""
        for event in self._steppers[self.now].take_events():
            sides = (self.system.outward(self.now, x) for x in (event.before, event.after))
            before, after = sides
            impulse = self.system.impulse(self.now, event.impulse)
            event = event._replace(before=before, after=after, impulse=impulse)
            self.events_so_far = self.events_so_far.after(event)

    def _count(self, t: float) -> None:
        """Refuse phases that follow one another in no time."""
        self._at_once = self._at_once + 1 if t <= self.since else 0
        if self._at_once > _MOST_AT_ONCE:
            names = ", ".join(phase.name for phase in self.phases)
            raise SolveError(f"t = {t:.9g} s: phases follow one another without end: {names}")

    def _inward(self, x: State) -> State:
        """The state as the system of its phase sees it; the same object where that was made."""
        if x is not self._last.outer or self._last.inner is None:
            self._last = _Pair(x, self.system.inward(x))
        assert self._last.inner is not None
        return self._last.inner

    def _outward(self, y: State) -> State:
        x = self.system.outward(self.now, y)
        self._last = _Pair(x, y)
        return x


class _Pair(NamedTuple):
    """A state as the scene sees it, and as the system of its phase does."""

    outer: State | None = None
    inner: State | None = None


def refuse_open(system: System, y: State, where: str) -> None:
    """Refuse a state after a reset that is off the rows of the phase that begins.

    Args:
        system: That of the phase.
        y: State of what it integrates.
        where: Which guard leads there, for the message.

    Raises:
        SolveError: Names the row that is most open.
    """
    rigid_rows = system.bilateral
    if not rigid_rows.rows:
        return
    g = rigid_rows.residual(y.t, y.q)
    rate = rigid_rows.jacobian(y.t, y.q).dot(y.v) + rigid_rows.rate(y.t, y.q)
    fastest = 1.0 + float(np.abs(y.v).max(initial=0.0))
    for size, unit, accepted in ((g, "m or rad", 1.0), (rate, "m/s or rad/s", fastest)):
        worst = int(np.argmax(np.abs(size)))
        if not abs(size[worst]) <= ASSEMBLED * accepted:
            raise SolveError(
                f"t = {y.t:.9g} s: {where}, whose row {rigid_rows.rows[worst].name} is "
                f"{abs(size[worst]):.3g} {unit} open: its reset has to close it"
            )
