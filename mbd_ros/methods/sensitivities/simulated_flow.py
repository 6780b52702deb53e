"""Hybrid flow of a scene, for return maps and their derivatives.

`SimulatedFlow` finds a cycle with the steps and events of a simulation. `SmoothMotion` repeats the
motion between two events with steps of order eight at fixed times, so that differences of motions
contain no noise from a step control. `set_coordinates` finds starts with given values of some
joints.
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

_MAX_ITERATIONS = 50  # to close a mechanism with given joints
_UNBOUNDED = 1.0e9  # step size [s]; the caller determines the ends of steps
_STEP = 1.0e-4  # difference step for rows [rad or m]
EndsCycle = Callable[[Segment], bool]
_TURN = 2.0 * np.pi  # rad
_NONE = np.zeros(0)


class SimulatedFlow(CheckedSteps):
    """Hybrid flow of a scene, in the integrated coordinates.

    Args:
        system: The equations of motion.
        integrator: Integration method that locates events.
        stabilization: Correction of constraint drift.
        dt: First guess of a step [s].
        ends_cycle: Function that returns whether a cycle ends with a segment.
        longest: Time within which a cycle must end [s].
        turning: Indices in v of angles, whose full turns do not count.

    Attributes:
        size: Dimension of a tangent step.
        longest: Argument of this name; may be changed.
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
        self._motions = [SmoothMotion(phase, dt) for phase in systems]
        self.size = 2 * self.system.nv + self.system.internals.nz
        self._turning = np.zeros(0, int) if turning is None else turning

    def plus(self, x: State, d: Array) -> State:
        """Return the state x (+) d, at the time and in the mode of x."""
        return self.system.chart.plus(x, d)

    def minus(self, x1: State, x0: State) -> Array:
        """Return the step d with x0 (+) d = x1, without full turns of joints, shape (size,)."""
        d = self.system.chart.minus(x1, x0)
        turns = self._turning
        d[turns] -= _TURN * np.round(d[turns] / _TURN)
        return d

    def basis(self, x: State) -> Array:
        """Return an orthonormal basis of the steps between consistent states, shape (size, d)."""
        return self._motion(x).basis(self._inward(x))

    def cycle(self, x: State) -> tuple[Segment, ...]:
        """Return the motion from a state to the end of one cycle, including its last event.

        Raises:
            FallError: The motion ends early, or lasts too long without the event.
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
        segment: Segment | None = None
        while y.t < limit:
            y = self._corrected(self._step(y, None, limit))
            self.stepper.continue_from(y)
            for event in self.stepper.take_events():
                end, after = self.system.reduce(event.before), self.system.reduce(event.after)
                guard = self._guard(event.guards, end)
                if segment is not None and end.t <= segment.end.t:
                    segment = _append_event(segment, event.guards, guard, end, after)
                    continue
                if segment is not None:
                    yield segment
                    if self._ends_cycle(segment):
                        return
                    begin, times = segment.after, [segment.after.t, *times[1:]]
                times += [end.t] if end.t > times[-1] else []
                segment = Segment(begin, np.array(times), end, after, event.guards, guard)
                times = [after.t]
            if segment is not None and y.t > segment.end.t:
                yield segment
                if self._ends_cycle(segment):
                    return
                begin, segment = segment.after, None
            if y.t > times[-1]:
                times.append(y.t)
        raise FallError(f"no cycle has ended after {self.longest:g} s")

    def follow(self, segment: Segment, x: State) -> State:
        """Return the end of a smooth motion from x with the steps of a segment, without guards."""
        end = self._motion(segment.begin).follow(self._inward(x), segment.times)
        return end._replace(mode=segment.end.mode)

    def rate(self, x: State) -> Array:
        """Return the rate of a state in its mode, in the tangent, shape (size,)."""
        return self._motion(x).rate(self._inward(x))

    def value(self, segment: Segment, x: State) -> float:
        """Return the value of the guard of a segment at a state near its end."""
        motion, y = self._motion(x), self._inward(x)
        if segment.guard.exit is None:
            return motion.margin(y, segment.guard.margin)
        system, crossing = motion.system, segment.guard.exit.crossing
        x = system.expand(y)
        lam = _NONE if isinstance(crossing, Combination | Gap) else system.evaluate(x).lam
        system.k.refresh(x.q, x.v, crossing.reads)
        return float(crossing.value(system.k, x, lam))

    def reset(self, segment: Segment, x: State) -> State:
        """Return the state after the event of a segment, from a state on its guard."""
        x = self._after(segment.guard, x)
        for guard, before in segment.guard.more:
            x = self._after(guard, x._replace(mode=before.mode))
        return x._replace(mode=segment.after.mode)

    def is_timed(self, segment: Segment) -> bool:
        """Return whether the event occurs at a fixed time after the begin of its phase."""
        phase_exit = segment.guard.exit
        return phase_exit is not None and phase_exit.crossing is None

    def ends_phase(self, segment: Segment) -> bool:
        """Return whether the event begins a phase, whose time counts from there."""
        guards = (segment.guard, *(guard for guard, _ in segment.guard.more))
        return any(guard.exit is not None for guard in guards)

    def project(self, x: State) -> State:
        """Return the state, projected onto the constraints of its mode."""
        return self._motion(x).project(self._inward(x))._replace(mode=x.mode)

    def with_own_guard(self, segment: Segment) -> Segment:
        """Return a segment of a scene with other parameters, with the guard of this scene."""
        more = tuple(
            (self._guard(segment.event, before), before) for _, before in segment.guard.more
        )
        guard = self._guard(segment.event, segment.end)._replace(more=more)
        return segment._replace(guard=guard)

    def states(self, segment: Segment, count: int) -> list[State]:
        """Return states of a segment at equidistant times, including both ends."""
        times = np.linspace(segment.begin.t, segment.end.t, count)
        motion, y = self._motion(segment.begin), self._inward(segment.begin)
        inner = motion.states(y, times)
        return [x._replace(mode=segment.begin.mode) for x in inner]

    def set_coordinates(
        self, x: State, positions: Mapping[int, float], velocities: Mapping[int, float]
    ) -> State:
        """Return a consistent state with given coordinates in the phase of x."""
        inner = set_coordinates(self._motion(x).system, self._inward(x), positions, velocities)
        return inner._replace(mode=x.mode)

    def residual(self, x: State) -> Array:
        """Return the residual of the position constraints in the phase of x [m or rad], (m,)."""
        system = self._motion(x).system
        if not system.bilateral.rows:
            return np.zeros(0)
        residual: Array = system.bilateral.residual(x.t, x.q)
        return residual

    def start(self, x: State) -> State:
        """Return the initial state of the integrated coordinates, in its mode.

        Args:
            x: State of all joints.

        Raises:
            SolveError: The mechanism cannot be assembled near x.
        """
        y = self._assembled(x)
        if self._nz:
            y = settled(self.system, y, None)
        self.stepper.restart()
        return self.stepper.settle(y, None)

    def _guard(self, names: tuple[str, ...], end: State) -> _Guard:
        if self._phased is not None:
            phase = self._phased.phases[self._phased.phase(end)]
            for phase_exit in phase.exits:
                if label(phase, phase_exit.name) in names:
                    return _Guard(exit=phase_exit)
        return _Guard(margin=self._motion(end).margin_at(names, self._inward(end)))

    def _after(self, guard: _Guard, x: State) -> State:
        """Return the state after one event, in the mode that begins."""
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
    """An exit of a phase or a margin of its mode, and further events at the same time."""

    exit: Any = None
    margin: Margin | None = None
    more: tuple[tuple[_Guard, State], ...] = ()


def _append_event(
    segment: Segment, names: tuple[str, ...], guard: _Guard, before: State, after: State
) -> Segment:
    """Return the segment with a further event at the time of its end."""
    more = (*segment.guard.more, (guard, before))
    event = (*segment.event, *names)
    return segment._replace(event=event, after=after, guard=segment.guard._replace(more=more))


class SmoothMotion:
    """Motion of a system in one mode, with steps at given times.

    Args:
        system: The system of one phase.
        dt: Interval of the output [s], which sets the tolerance of events.
    """

    def __init__(self, system: System, dt: float) -> None:
        self.system = system
        self._steps = prepare_stepper(_FixedSteps(), system, _UNBOUNDED)
        self._field: ModeField | None = None
        self._transitions: Transitions | None = None
        rows, guards = event_sources(system)
        if rows or guards:
            self._field = ModeField(system, with_surfaces=False)
            self._transitions = Transitions(self._field, dt)

    def follow(self, y: State, times: Array) -> State:
        """Return the end of a motion from a state, which is projected onto its constraints first.

        Args:
            y: State of the integrated coordinates, in its mode.
            times: Time of the begin and of the ends of all steps [s], shape (n + 1,).
        """
        return self.project(self._integrate(y, times)[-1])

    def states(self, y: State, times: Array) -> list[State]:
        """Return the states at the ends of the steps of `follow`."""
        return [self.project(state) for state in self._integrate(y, times)]

    def _integrate(self, y: State, times: Array) -> list[State]:
        """Integrate with order eight, whose constraint drift in a cycle is negligible."""
        y = self.project(y)
        states = [y]
        self._steps.restart()
        self._steps.follow(self.system.accelerator(y.mode), y.mode)
        late = y.t - float(times[0])
        for t in times[1:].tolist():
            y = self._steps.step(y, None, t + late)
            states.append(y)
        return states

    def basis(self, y: State) -> Array:
        """Return an orthonormal basis of the consistent steps, shape (2 nv + nz, d)."""
        system, n = self.system, self.system.nv
        bilateral, nz = system.bilateral, len(y.z)
        if not bilateral.rows:
            return np.eye(2 * n + nz)

        def residuals(length: float, direction: Array) -> Array:
            q = system.chart.integrate(y.q, length * direction)
            rate = bilateral.jacobian(y.t, q).dot(y.v) + bilateral.rate(y.t, q)
            return np.concatenate((bilateral.residual(y.t, q), rate))

        # A closed contact may be anywhere on its ground: its rows are not derivatives of its gaps
        by_q = np.array([slope(partial(residuals, direction=d), _STEP) for d in np.eye(n)]).T
        rows = bilateral.jacobian(y.t, y.q)
        by_v = np.vstack((np.zeros_like(rows), rows))
        every = np.hstack((by_q, by_v, np.zeros((len(by_q), nz))))
        _, sizes, right = np.linalg.svd(every, full_matrices=True)
        basis: Array = right[int(np.sum(sizes > SINGULAR * sizes[0])) :].T
        return basis

    def project(self, y: State) -> State:
        """Return the state, projected onto the constraints of its mode."""
        y = project(self.system, y)
        if self._field is None or self._field.rows is None:
            return y
        return self._field.project_rows(y, y.mode)

    def rate(self, y: State) -> Array:
        """Return velocities, accelerations and rates of internal states in the mode of y."""
        a, zdot = np.zeros(self.system.nv), np.zeros(len(y.z))
        accelerate = self.system.accelerator(y.mode)
        if self.system.internals.nz:
            accelerate(y.t, y.q, y.v, y.z, None, a, zdot)
        else:
            accelerate(y.t, y.q, y.v, None, a)
        return np.concatenate((y.v, a, zdot))

    def margin_at(self, names: tuple[str, ...], y: State) -> Margin:
        """Return the margin that is zero at an event with one of these names."""
        field = self._switches()
        numbers = {field.names.index(name) for name in names}
        guards = [i for i in numbers if i >= len(y.mode)]
        if guards:
            return guards[0], 0
        margins = {m: v for m, v in field.margins(y, None, y.mode).items() if m[0] in numbers}
        return min(margins, key=lambda which: abs(margins[which]))

    def margin(self, y: State, which: Margin) -> float:
        """Return the value of a margin of the mode, or of a guard of a part."""
        field, first = self._switches(), len(y.mode)
        if which[0] >= first:
            return float(field.guards.values(y, None, y.mode)[which[0] - first])
        return field.margin(y, None, y.mode, which)

    def after(self, y: State, which: Margin) -> State:
        """Return the state after the event at which a margin is zero."""
        field = self._switches()
        if which[0] >= len(y.mode):
            return field.reset(y, None, [which[0]])
        assert self._transitions is not None
        self._transitions.restart()
        return self._transitions.happen(y, None, which)

    def _switches(self) -> ModeField:
        assert self._field is not None
        return self._field


class _FixedSteps(Integrator):
    """Steps of order eight at given times."""

    order: int = 8
    dense: ClassVar[bool] = True

    def prepare(self, system: Any, dt: float) -> Stepper:
        return runge_kutta(system, DOP853, dt, None)


def set_coordinates(
    system: Any, y: State, positions: Mapping[int, float], velocities: Mapping[int, float]
) -> State:
    """Return a consistent state with given coordinates and velocities.

    The given values are exact, and all other coordinates adapt. A projection in the mass metric
    would instead change a light leg next to a heavy trunk.

    Args:
        system: The system of the phase.
        y: State of the integrated coordinates; the other coordinates stay near it.
        positions: Changes of coordinates by their index in v [rad or m].
        velocities: Velocities by their index in v [rad/s or m/s].

    Raises:
        SolveError: The constraints of the phase cannot be satisfied with these values.
    """
    step = np.zeros(system.nv)
    for index, change in positions.items():
        step[index] = change
    q, v = system.chart.integrate(y.q, step), y.v.copy()
    for index, value in velocities.items():
        v[index] = value
    if system.bilateral.rows:
        q = _close_positions(
            system, y.t, q, np.array([i not in positions for i in range(system.nv)])
        )
        v = _close_velocities(
            system, y.t, q, v, np.array([i not in velocities for i in range(system.nv)])
        )
    y = y._replace(q=q, v=v)
    off = violation(system, y)
    if max(off.position, off.velocity) > ASSEMBLED * (1.0 + float(np.abs(v).max(initial=0.0))):
        raise SolveError("the mechanism cannot be closed with the given values of joints")
    return y


def _close_positions(system: Any, t: float, q: Array, loose: Array) -> Array:
    """Return a configuration with closed rows by changing only the loose coordinates."""
    bilateral = system.bilateral
    for _ in range(_MAX_ITERATIONS):
        change = np.linalg.lstsq(bilateral.jacobian(t, q)[:, loose], bilateral.residual(t, q))[0]
        longest = float(np.abs(change).max(initial=0.0))
        step = np.zeros(system.nv)
        step[loose] = -change * min(1.0, BRANCH_STEP / max(longest, LANDED))
        q = system.chart.integrate(q, step)
        if longest <= LANDED:
            break
    return q


def _close_velocities(system: Any, t: float, q: Array, v: Array, loose: Array) -> Array:
    """Return a consistent velocity by changing only the loose coordinates."""
    jacobian = system.bilateral.jacobian(t, q)
    off = jacobian.dot(v) + system.bilateral.rate(t, q)
    v[loose] -= np.linalg.lstsq(jacobian[:, loose], off)[0]
    return v
