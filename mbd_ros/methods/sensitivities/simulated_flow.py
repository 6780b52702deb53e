"""The motion of a scene with events, as a return map asks for it.

`SimulatedFlow` takes the steps and the events of a simulation. Between events, `SmoothMotion`
follows one mode with steps of order eight whose ends are given, so that differences of motions
have no noise of a step control. `placed` finds starts with given values of some joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mbd_ros.core.contracts import label
from mbd_ros.core.dynamics.internal_dynamics import settled
from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED, BRANCH_STEP, LANDED, SINGULAR
from mbd_ros.errors import DivergedError, FallError, SolveError
from mbd_ros.methods.events.crossings import Combination, Gap
from mbd_ros.methods.events.event_steps import Transitions
from mbd_ros.methods.events.mode_field import Margin, ModeField
from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.runge_kutta import runge_kutta
from mbd_ros.methods.integration.stepping import Integrator, Stepper
from mbd_ros.methods.projection.assembly import Stabilization, project, violation
from mbd_ros.methods.sensitivities.flow import Segment
from mbd_ros.methods.sensitivities.saltation import slope
from mbd_ros.methods.simulation.checked_steps import CheckedSteps, event_sources, prepare_stepper

_MOST = 50  # steps that close a mechanism with given joints
_UNBOUNDED = 1.0e9  # s: steps end where they are told
_ASIDE = 1.0e-4  # rad or m: for the change of rows
EndsCycle = Callable[[Segment], bool]
_TURN = 2.0 * np.pi  # rad
_NONE = np.zeros(0)


class SimulatedFlow(CheckedSteps):
    """Motions of a scene, in the coordinates that are integrated.

    Args:
        integrator: The method, which has to find events.
        stabilization: Keeps its rows.
        dt: First guess of a step [s].
        ends_cycle: Whether a cycle ends with a segment.
        longest: Time within which a cycle has to end [s].
        turning: Which coordinates of a velocity are turns, so that whole ones do not count.

    Attributes:
        size: Length of a tangent.
        longest: As given; may be changed.
    """

    def __init__(
        self,
        system: System,
        integrator: Integrator,
        stabilization: Stabilization,
        dt: float,
        ends_cycle: EndsCycle,
        longest: float,
        turning: Array | None = None,
    ) -> None:
        super().__init__(system, integrator, stabilization, dt)
        self._ends_cycle = ends_cycle
        self.longest = longest
        phased = self.system if isinstance(self.system, PhasedSystem) else None
        self._phased = phased
        systems = (self.system,) if phased is None else phased.systems
        self._motions = [SmoothMotion(one, dt) for one in systems]
        self.size = 2 * self.system.nv + self.system.internals.nz
        self._turning = np.zeros(0, int) if turning is None else turning

    def plus(self, x: State, d: Array) -> State:
        """The state x (+) d, at the time and in the mode of x."""
        return self.system.chart.plus(x, d)

    def minus(self, x1: State, x0: State) -> Array:
        """The d with x0 (+) d = x1, shape (size,); whole turns of joints do not count."""
        apart = self.system.chart.minus(x1, x0)
        turns = self._turning
        apart[turns] -= _TURN * np.round(apart[turns] / _TURN)
        return apart

    def basis(self, x: State) -> Array:
        """Orthonormal tangents along which a consistent state stays so, shape (size, d)."""
        return self._motion(x).basis(self._inward(x))

    def cycle(self, x: State) -> tuple[Segment, ...]:
        """The motion from a state to the end of one cycle, that event included.

        Raises:
            FallError: The motion ends early, or goes on for too long without the event.
        """
        try:
            return tuple(self._segments(x))
        except (SolveError, DivergedError) as error:
            raise FallError(str(error)) from error

    def _segments(self, x: State) -> Iterator[Segment]:
        self.stepper.restart()
        y = self.stepper.settle(x, None)
        self.stepper.take_events()
        begin, times, limit = y, [y.t], x.t + self.longest
        found: Segment | None = None
        while y.t < limit:
            y = self._corrected(self._step(y, None, limit))
            self.stepper.continue_from(y)
            for event in self.stepper.take_events():
                end, after = self.system.reduce(event.before), self.system.reduce(event.after)
                guard = self._guard(event.guards, end)
                if found is not None and end.t <= found.end.t:
                    found = _joined(found, event.guards, guard, end, after)
                    continue
                if found is not None:
                    yield found
                    if self._ends_cycle(found):
                        return
                    begin, times = found.after, [found.after.t, *times[1:]]
                times += [end.t] if end.t > times[-1] else []
                found = Segment(begin, np.array(times), end, after, event.guards, guard)
                times = [after.t]
            if found is not None and y.t > found.end.t:
                yield found
                if self._ends_cycle(found):
                    return
                begin, found = found.after, None
            if y.t > times[-1]:
                times.append(y.t)
        raise FallError(f"no cycle has ended after {self.longest:g} s")

    def follow(self, segment: Segment, x: State) -> State:
        """The end of a smooth motion from x with the steps of a segment, guards ignored."""
        end = self._motion(segment.begin).follow(self._inward(x), segment.times)
        return end._replace(mode=segment.end.mode)

    def rate(self, x: State) -> Array:
        """Rate of a state in its mode, in the tangent, shape (size,)."""
        return self._motion(x).rate(self._inward(x))

    def value(self, segment: Segment, x: State) -> float:
        """The guard at the end of a segment, at a state near that end."""
        motion, y = self._motion(x), self._inward(x)
        if segment.guard.exit is None:
            return motion.margin(y, segment.guard.margin)
        system, crossing = motion.system, segment.guard.exit.crossing
        every = system.expand(y)
        lam = _NONE if isinstance(crossing, Combination | Gap) else system.evaluate(every).lam
        system.k.refresh(every.q, every.v, crossing.reads)
        return float(crossing.value(system.k, every, lam))

    def reset(self, segment: Segment, x: State) -> State:
        """The state after the event at the end of a segment, from one at which its guard is 0."""
        x = self._after(segment.guard, x)
        for guard, before in segment.guard.more:
            x = self._after(guard, x._replace(mode=before.mode))
        return x._replace(mode=segment.after.mode)

    def is_timed(self, segment: Segment) -> bool:
        """Whether the event at the end comes a given time after the begin of its phase."""
        one = segment.guard.exit
        return one is not None and one.crossing is None

    def ends_phase(self, segment: Segment) -> bool:
        """Whether the event at the end begins a phase, whose time counts from there."""
        guards = (segment.guard, *(guard for guard, _ in segment.guard.more))
        return any(guard.exit is not None for guard in guards)

    def onto(self, x: State) -> State:
        """The state on the rows of its mode."""
        return self._motion(x).onto(self._inward(x))._replace(mode=x.mode)

    def own(self, segment: Segment) -> Segment:
        """A segment of the same scene with other numbers, with the guard of this one."""
        more = tuple(
            (self._guard(segment.event, before), before) for _, before in segment.guard.more
        )
        guard = self._guard(segment.event, segment.end)._replace(more=more)
        return segment._replace(guard=guard)

    def states(self, segment: Segment, count: int) -> list[State]:
        """States of a segment at equal times, both ends included."""
        times = np.linspace(segment.begin.t, segment.end.t, count)
        motion, y = self._motion(segment.begin), self._inward(segment.begin)
        inner = motion.states(y, times)
        return [x._replace(mode=segment.begin.mode) for x in inner]

    def placed(
        self, x: State, positions: Mapping[int, float], velocities: Mapping[int, float]
    ) -> State:
        """A consistent state with given positions and velocities, in the phase of a state."""
        inner = placed(self._motion(x).system, self._inward(x), positions, velocities)
        return inner._replace(mode=x.mode)

    def open(self, x: State) -> Array:
        """How far rows of positions are open in the phase of a state [m or rad], shape (m,)."""
        system = self._motion(x).system
        if not system.bilateral.rows:
            return np.zeros(0)
        residual: Array = system.bilateral.residual(x.t, x.q)
        return residual

    def started(self, x: State) -> State:
        """The state of what is integrated, in its mode, from one of all joints.

        Raises:
            SolveError: The mechanism cannot be assembled near it.
        """
        y = self._assembled(x)
        if self._nz:
            y = settled(self.system, y, None)
        self.stepper.restart()
        return self.stepper.settle(y, None)

    def _guard(self, names: tuple[str, ...], end: State) -> _Guard:
        if self._phased is not None:
            phase = self._phased.phases[self._phased.phase(end)]
            for one in phase.exits:
                if label(phase, one.name) in names:
                    return _Guard(exit=one)
        return _Guard(margin=self._motion(end).margin_at(names, self._inward(end)))

    def _after(self, guard: _Guard, x: State) -> State:
        """The state after one event, in the mode that begins."""
        motion, y = self._motion(x), self._inward(x)
        if guard.exit is None:
            assert guard.margin is not None
            after = motion.after(y, guard.margin)
            phase = 0 if self._phased is None else self._phased.phase(x)
            return after if self._phased is None else self._phased.outward(phase, after)
        assert self._phased is not None
        struck = guard.exit.reset.after(motion.system.expand(y))
        system = self._phased.systems[guard.exit.then]
        return system.reduce(struck.x._replace(mode=()))

    def _motion(self, x: State) -> SmoothMotion:
        return self._motions[0 if self._phased is None else self._phased.phase(x)]

    def _inward(self, x: State) -> State:
        return x if self._phased is None else self._phased.inward(x)


class _Guard(NamedTuple):
    """An exit of a phase or a margin of its mode, and what follows in no time."""

    exit: Any = None
    margin: Margin | None = None
    more: tuple[tuple[_Guard, State], ...] = ()


def _joined(
    found: Segment, names: tuple[str, ...], guard: _Guard, before: State, after: State
) -> Segment:
    """A segment whose end leads on in no time."""
    more = (*found.guard.more, (guard, before))
    event = (*found.event, *names)
    return found._replace(event=event, after=after, guard=found.guard._replace(more=more))


class SmoothMotion:
    """Motion of a system in one mode, with steps that somebody else has chosen.

    Args:
        system: The system of one phase.
        dt: Interval of the output, for the tolerance of events [s].
    """

    def __init__(self, system: System, dt: float) -> None:
        self.system = system
        self._steps = prepare_stepper(_GivenSteps(), system, _UNBOUNDED)
        self._field: ModeField | None = None
        self._transitions: Transitions | None = None
        rows, guards = event_sources(system)
        if rows or guards:
            self._field = ModeField(system, with_surfaces=False)
            self._transitions = Transitions(self._field, dt)

    def follow(self, y: State, times: Array) -> State:
        """The end of a motion from a state, moved onto its rows first.

        Args:
            y: State of what is integrated, in its mode.
            times: Ends of steps, the begin first [s], shape (n + 1,).
        """
        return self.onto(self._followed(y, times)[-1])

    def states(self, y: State, times: Array) -> list[State]:
        """The states at the ends of the steps of `follow`."""
        return [self.onto(each) for each in self._followed(y, times)]

    def _followed(self, y: State, times: Array) -> list[State]:
        """States after steps of order eight, whose drift off the rows is rounding in a cycle."""
        y = self.onto(y)
        found = [y]
        self._steps.restart()
        self._steps.follow(self.system.accelerator(y.mode), y.mode)
        late = y.t - float(times[0])
        for t in times[1:].tolist():
            y = self._steps.step(y, None, t + late)
            found.append(y)
        return found

    def basis(self, y: State) -> Array:
        """Orthonormal tangents that keep the rows of its phase, shape (2 nv + nz, d)."""
        system, n = self.system, self.system.nv
        held, nz = system.bilateral, len(y.z)
        if not held.rows:
            return np.eye(2 * n + nz)

        def seen(length: float, direction: Array) -> Array:
            q = system.chart.integrate(y.q, length * direction)
            rate = held.jacobian(y.t, q).dot(y.v) + held.rate(y.t, q)
            return np.concatenate((held.residual(y.t, q), rate))

        # A contact that is held may be anywhere on its ground: rows are no derivatives of gaps
        by_q = np.array([slope(partial(seen, direction=d), _ASIDE) for d in np.eye(n)]).T
        rows = held.jacobian(y.t, y.q)
        by_v = np.vstack((np.zeros_like(rows), rows))
        every = np.hstack((by_q, by_v, np.zeros((len(by_q), nz))))
        _, sizes, right = np.linalg.svd(every, full_matrices=True)
        kept: Array = right[int(np.sum(sizes > SINGULAR * sizes[0])) :].T
        return kept

    def onto(self, y: State) -> State:
        """The state on the rows of its mode."""
        y = project(self.system, y)
        if self._field is None or self._field.rows is None:
            return y
        return self._field.project_rows(y, y.mode)

    def rate(self, y: State) -> Array:
        """Velocities, accelerations and rates of internal states in its mode."""
        a, zdot = np.zeros(self.system.nv), np.zeros(len(y.z))
        accelerate = self.system.accelerator(y.mode)
        if self.system.internals.nz:
            accelerate(y.t, y.q, y.v, y.z, None, a, zdot)
        else:
            accelerate(y.t, y.q, y.v, None, a)
        return np.concatenate((y.v, a, zdot))

    def margin_at(self, names: tuple[str, ...], y: State) -> Margin:
        """Which margin is zero where something of these names happens in this mode."""
        field = self._switches()
        numbers = {field.names.index(name) for name in names}
        guards = [i for i in numbers if i >= len(y.mode)]
        if guards:
            return guards[0], 0
        margins = {m: v for m, v in field.margins(y, None, y.mode).items() if m[0] in numbers}
        return min(margins, key=lambda which: abs(margins[which]))

    def margin(self, y: State, which: Margin) -> float:
        """A margin of the mode; of a guard of a part its value."""
        field, first = self._switches(), len(y.mode)
        if which[0] >= first:
            return float(field.guards.values(y, None, y.mode)[which[0] - first])
        return field.margin(y, None, y.mode, which)

    def after(self, y: State, which: Margin) -> State:
        """The state after what happens where a margin is zero."""
        field = self._switches()
        if which[0] >= len(y.mode):
            return field.reset(y, None, [which[0]])
        assert self._transitions is not None
        self._transitions.restart()
        return self._transitions.happen(y, None, which)

    def _switches(self) -> ModeField:
        assert self._field is not None
        return self._field


class _GivenSteps(Integrator):
    """Steps of order eight whose ends are given."""

    order: int = 8
    dense: ClassVar[bool] = True

    def prepare(self, system: Any, dt: float) -> Stepper:
        return runge_kutta(system, DOP853, dt, None)


def placed(
    system: Any, y: State, positions: Mapping[int, float], velocities: Mapping[int, float]
) -> State:
    """A consistent state with given positions and velocities.

    The nearest consistent state by masses would give way where a light leg is placed beside a
    heavy trunk; here it is the trunk that follows.

    Args:
        system: The system of its phase.
        y: State of what is integrated; what is not given stays near it.
        positions: Changes of coordinates, by their index in a velocity [rad or m].
        velocities: Values by their index [rad/s or m/s].

    Raises:
        SolveError: The rows of the phase cannot be closed with them.
    """
    step = np.zeros(system.nv)
    for index, change in positions.items():
        step[index] = change
    q, v = system.chart.integrate(y.q, step), y.v.copy()
    for index, value in velocities.items():
        v[index] = value
    if system.bilateral.rows:
        q = _closed(system, y.t, q, np.array([i not in positions for i in range(system.nv)]))
        v = _closing(system, y.t, q, v, np.array([i not in velocities for i in range(system.nv)]))
    y = y._replace(q=q, v=v)
    off = violation(system, y)
    if max(off.position, off.velocity) > ASSEMBLED * (1.0 + float(np.abs(v).max(initial=0.0))):
        raise SolveError("the mechanism cannot be closed with the joints where they are asked for")
    return y


def _closed(system: Any, t: float, q: Array, loose: Array) -> Array:
    """The configuration with closed rows, some coordinates fixed."""
    held = system.bilateral
    for _ in range(_MOST):
        found = np.linalg.lstsq(held.jacobian(t, q)[:, loose], held.residual(t, q))[0]
        longest = float(np.abs(found).max(initial=0.0))
        step = np.zeros(system.nv)
        step[loose] = -found * min(1.0, BRANCH_STEP / max(longest, LANDED))
        q = system.chart.integrate(q, step)
        if longest <= LANDED:
            break
    return q


def _closing(system: Any, t: float, q: Array, v: Array, loose: Array) -> Array:
    """The velocity that keeps the rows closed, some of it fixed."""
    jacobian = system.bilateral.jacobian(t, q)
    off = jacobian.dot(v) + system.bilateral.rate(t, q)
    v[loose] -= np.linalg.lstsq(jacobian[:, loose], off)[0]
    return v
