"""Steps of a system that are checked, corrected and counted.

`CheckedSteps` is the base of simulations. A step to a state that is not finite is an error that
names the lost quantities and the last finite state; `Overshoots` records how far joints pass their
stops.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Part, type_name
from mbd_ros.core.dynamics.mass import check_mass
from mbd_ros.core.dynamics.system import System, during, phased
from mbd_ros.core.model.robot import Joint
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.state import Array, Memory, State, copied, is_same, recognised
from mbd_ros.errors import DivergedError, ModelError, SolveError
from mbd_ros.methods.integration.stepping import BlockStepper, Integrator, Stepper
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.methods.projection.initial_state import consistent_start

if TYPE_CHECKING:
    from mbd_ros.core.complementarity.contact_problem import Residuals
    from mbd_ros.methods.events.step_events import Event

_SHOWN = 8  # joints in a message
_COUNTED = 1.0e150  # largest number whose square is finite
_IN_REACH = 1.0e6  # [rad or m] beyond which rounding spoils the mass matrix
_REPORTED = 1.0e-4  # [rad or m]; steps that resolve an impact leave far smaller overshoots
_CHECKPOINT_FIELDS = ("_first", "_worst", "_limit", "_speed", "_when", "_seen")


class CheckedSteps:
    """Steps of a system with checks, correction of constraint drift, and a record of events.

    Args:
        system: The equations of motion.
        integrator: The integration method.
        stabilization: Correction of constraint drift.
        dt: Step of a fixed-step method, and interval of the output [s], > 0.

    Attributes:
        steps: Steps taken so far.
        worst: Largest condition number of the rows after a step, inf where they are redundant,
            and its time [s]. Beyond some 1e6, near a toggle, multipliers are unreliable.
        overshoots: Overshoots of joints beyond their smoothed stops; None without such stops.
        guards: Names of the events that can occur, in the order of the scene.
        switches: Names of the entries of a mode, in their order.
    """

    def __init__(
        self, system: System, integrator: Integrator, stabilization: Stabilization, dt: float
    ) -> None:
        if not dt > 0:
            raise ModelError(f"dt {dt:g} s must be > 0")
        system = system.with_gains(*stabilization.gains(dt))
        self.integrator = integrator
        self.dt = dt
        self.stabilization = stabilization
        self.stepper = build_stepper(integrator, system, dt)
        self.system: System = self.stepper.system or system
        self.guards = self.stepper.guards
        self.switches = self.stepper.switches
        self.steps = 0
        self.worst = (1.0, 0.0)
        has_stops = any(block.part.stops for block in system.layout.smoothed)
        self.overshoots = Overshoots(system) if has_stops else None
        several = phased(system)
        systems = (system,) if several is None else several.systems
        has_rows = any(phase.bilateral.rows for phase in systems)
        self._is_corrected = has_rows and not integrator.keeps_constraints
        self._nz = system.internals.nz
        self._made_by = integrator.title, dt, system.nq, system.nv, self._nz
        self._evaluations = self.system.evaluations  # before the start
        self._began: tuple[State, State] | None = None

    def _assembled(self, x: State) -> State:
        """Return the nearest consistent state, from a cache if the last start was the same."""
        if self._began is not None and is_same(x, self._began[0]):
            return self._began[1]
        y = consistent_start(during(self.system, x), x)
        self._began = x, y
        return y

    def _corrected(self, y: State) -> State:
        """Return the state after a step, projected onto the constraints."""
        if not self._is_corrected:
            return y
        system = during(self.system, y)
        corrected = self.stabilization.correct(system, y)
        if system.condition > self.worst[0]:
            self.worst = system.condition, y.t
        return corrected

    def _step(self, y: State, u: Array | None, end: float, most: int = 1) -> State:
        """Take one step, or up to `most` steps without checks in between."""
        try:
            if most == 1 or not self.stepper.can_stride:
                after, count = self.stepper.step(y, u, end), 1
            else:
                after, count = self.stepper.stride(y, u, end, most)
        except (DivergedError, SolveError) as error:
            raise type(error)(f"{error}; {last_finite(self.system, y)}") from error
        self.steps += count
        is_finite = math.isfinite(after.v.dot(after.v)) and math.isfinite(after.q.dot(after.q))
        if is_finite and (not self._nz or math.isfinite(after.z.dot(after.z))):
            if self.overshoots is not None:
                self.overshoots.observe(y, after)
            return after
        raise divergence(self.system, y, after)

    @property
    def evaluations(self) -> int:
        """Number of evaluations of accelerations so far."""
        in_blocks = self.stepper.evaluations if isinstance(self.stepper, BlockStepper) else 0
        return self.system.evaluations - self._evaluations + in_blocks

    @property
    def events(self) -> list[Event]:
        """Events since the start or the last `take_events`, in the order of time."""
        return list(self.stepper.events)

    def take_events(self) -> tuple[Event, ...]:
        """Return the events and clear them, so that the list of a long simulation stays short."""
        return tuple(self.stepper.take_events())

    def take_residuals(self) -> Residuals | None:
        """Return the worst contact residuals since the last call; None without contacts."""
        worst: Residuals | None = self.stepper.residuals
        self.stepper.reset_residuals()
        return worst

    def passed_stops(self) -> list[str]:
        """Return a message for each joint that passed a stop since the start."""
        if self.overshoots is None:
            return []
        return [str(overshoot) for overshoot in self.overshoots.reportable()]


def divergence(system: System, y: State, after: State) -> DivergedError:
    """Return the error of a step from a finite state to one that is not finite."""
    return DivergedError(
        f"diverged at t = {after.t:.9g} s: {_lost(system, after)}; {last_finite(system, y)}; "
        f"{_advice(system, y)}"
    )


def _lost(system: System, after: State) -> str:
    lost = int(np.count_nonzero(~np.isfinite(after.v)))
    if lost:
        return f"{lost} of {len(after.v)} velocities are not finite"
    states = zip(system.internals.names, (np.abs(after.z) < _COUNTED).tolist(), strict=True)
    names = [name for name, is_counted in states if not is_counted]
    if names:
        return f"{', '.join(names[:_SHOWN])} overflowed"
    return "positions or velocities overflowed"


def _advice(system: System, y: State) -> str:
    try:
        if np.abs(y.q).max(initial=0.0) < _IN_REACH:  # beyond, rounding decides
            check_mass(system, y.q)
    except SolveError as error:
        return str(error)
    return "try a smaller dt"


def last_finite(system: System, y: State) -> str:
    """Describe the last finite state: time, fastest joint or free body, positions."""
    x, robot = system.expand(y), system.robot
    speeds = {joint.name: (float(x.v[joint.v]), "joint") for joint in robot.joints}
    places = [f"{joint.name} {x.q[joint.q]:.4g}" for joint in robot.joints[:_SHOWN]]
    for base in robot.bases:
        from mbd_ros.core.kinematics.poses import world_pose  # only where something flies

        fastest = max(x.v[base.v].tolist(), key=abs)
        speeds[base.name] = fastest, "free body"
        place = world_pose(robot, x.q[base.q])[:3]
        places.append(f"{base.name} {', '.join(f'{value:.4g}' for value in place.tolist())}")
    name = max(speeds, key=lambda key: abs(speeds[key][0]))
    speed, kind = speeds[name]
    more = ", .." if len(speeds) > _SHOWN else ""
    return (
        f"last finite state at t = {y.t:.9g} s: fastest {kind} {name} with {speed:.3g}/s; "
        f"positions {', '.join(places[:_SHOWN])}{more}"
    )


class Overshoots:
    """Largest overshoot at each end of each smoothed stop of a system.

    A stop that acts before its end is reached is not passed, but one that a step jumps over is.
    Steps without an active bounded row cost nothing.

    Args:
        system: The system, with smoothed stops.
    """

    def __init__(self, system: Any) -> None:
        self._system = system
        stops = [stop for block in system.layout.smoothed for stop in block.part.stops]
        self._joints = [stop.joint for stop in stops] * 2
        self._q = np.array([joint.q for joint in self._joints], dtype=np.intp)
        self._v = np.array([joint.v for joint in self._joints], dtype=np.intp)
        self._signs = np.repeat([-1.0, 1.0], len(stops))
        ends = [stop.lower for stop in stops] + [stop.upper for stop in stops]
        self._ends = self._signs * ends
        self._speed, self._when = np.zeros((2, len(ends)))
        self._first = self._worst = np.zeros(len(ends))
        self._limit = self._ends + self._worst
        self._seen = None

    def begin(self, y: Any) -> None:
        """Begin at a state; ends that it has already passed do not count."""
        self._first = np.maximum(self._outwards(y) - self._ends, 0.0)
        self._speed, self._when = np.zeros((2, len(self._ends)))
        self._worst, self._limit, self._seen = self._first, self._ends + self._first, y

    def checkpoint(self) -> Memory:
        """Return a copy of all overshoots so far."""
        return {name: copied(getattr(self, name)) for name in _CHECKPOINT_FIELDS}

    def restore(self, checkpoint: Memory, y: Any) -> None:
        """Return to a checkpoint; y is the state from which the next step starts."""
        for name, value in checkpoint.items():
            setattr(self, name, recognised(copied(value), y))

    def observe(self, y: Any, y_next: Any) -> None:
        """Record a step from one state of the integrated coordinates to the next."""
        if not self._system.bounded.acts:
            return
        if y is not self._seen:  # a stop may act only in the step after that which passed it
            self._compare(y, y)
        self._compare(y_next, y)
        self._seen = y_next

    def reportable(self) -> list[Overshoot]:
        """Return the overshoots that are worth a report: at lower ends, then at upper ends."""
        return [
            Overshoot(
                self._joints[i],
                float(self._signs[i] * self._ends[i]),
                float(self._worst[i]),
                float(self._when[i]),
                float(self._speed[i]),
            )
            for i in np.flatnonzero(self._worst - self._first > _REPORTED).tolist()
        ]

    def _outwards(self, y: Any) -> Array:
        """Return positions of the joints in the direction of each end, shape (2 n,)."""
        outwards: Array = self._signs * self._system.expand(y).q[self._q]
        return outwards

    def _compare(self, y: Any, before: Any) -> None:
        outwards = self._outwards(y)
        if not (outwards > self._limit).any():
            return
        beyond = outwards - self._ends
        further = beyond > self._worst
        speed = np.abs(self._system.expand(before).v[self._v])
        self._when = np.where(further, y.t, self._when)
        self._speed = np.where(further, np.maximum(speed, self._speed), self._speed)
        self._worst = np.where(further, beyond, self._worst)
        self._limit = self._ends + self._worst


class Overshoot(NamedTuple):
    """Overshoot of a joint beyond a stop.

    Attributes:
        joint: The joint.
        end: End of the stop that it passed [rad or m].
        size: Distance beyond the end [rad or m].
        t: Time of the largest overshoot [s].
        speed: Largest speed at the start of the steps that led there [rad/s or m/s].
    """

    joint: Joint
    end: float
    size: float
    t: float
    speed: float

    def __str__(self) -> str:
        unit = "m" if self.joint.kind == "prismatic" else "rad"
        return (
            f"{self.joint.name} passes its stop at {self.end:g} {unit} by {self.size:.3g} {unit}, "
            f"at t = {self.t:.6g} s, with a speed of up to {self.speed:.3g} {unit}/s"
        )


def build_stepper(method: Integrator, system: System, dt: float) -> Stepper:
    """Build the stepper of a method, with event location if the scene has events.

    Args:
        method: The integration method.
        system: The system to integrate.
        dt: Length of a step, or first guess [s].

    Raises:
        ModelError: The method cannot stop at events or cannot integrate internal states, or
            switching surfaces are combined with smoothed rows; the message names them.
    """
    if (several := phased(system)) is not None:
        from mbd_ros.methods.events.phases import PhaseSteps

        return PhaseSteps(several, lambda phase: build_stepper(method, phase, dt))
    rows, guards = event_sources(system)
    surfaces = method.finds_surfaces and any(force.surfaces for force in system.loads.forces)
    if not (guards or surfaces) and (method.at_velocity_level or not rows):
        return prepare_stepper(method, system, dt)
    if not method.event_driven:
        alternative = "; or smoothed: true at these constraints" if rows and not guards else ""
        raise ModelError(
            f"integrator {method.title} does not stop at events, which exact rows and "
            f"guards need: {', '.join((*rows, *guards))}; accepted: rk4, dopri5, dop853, "
            f"filippov, gauss_legendre, adams, and moreau_jean without guards{alternative}"
        )
    _refuse_kinks(method, system)
    from mbd_ros.methods.events.event_steps import EventSteps
    from mbd_ros.methods.events.mode_field import ModeField

    field = ModeField(system, surfaces)
    steps = method.event_steps or EventSteps
    if field.has_contacts and not system.chart.is_flat:
        return steps(field, _world_axes_stepper(method, field.system, dt), dt)
    return steps(field, prepare_stepper(method, field.system, dt), dt)


def event_sources(system: System) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of event-driven rows, and of parts with guards."""
    rows = () if system.event_rows is None else tuple(system.event_rows.names)
    return rows, tuple(part.name for part in _parts(system) if part.guards)


def _parts(system: System) -> Iterator[Part]:
    yield from system.loads.actuators
    yield from system.loads.forces
    yield from (block.part for block in system.layout.blocks)
    yield from system.loads.watching


def prepare_stepper(method: Integrator, system: System, dt: float) -> Stepper:
    """Prepare the stepper of a method, including internal states."""
    if not system.internals.nz or method.at_velocity_level or method.moves_internal:
        return method.prepare(system, dt)
    if not method.keeps_internal:
        names = ", ".join(filter(None, system.internals.names))
        raise ModelError(
            f"integrator {type_name(type(method))} cannot integrate the internal states of the "
            f"scene, {names}; choose another integrator, such as rk4"
        )
    from mbd_ros.methods.integration.adapted_steps import InternalSteps

    return InternalSteps(method, system, dt)


def _refuse_kinks(method: Integrator, system: System) -> None:
    """Check that the gaps of all contacts are smooth, as event location requires.

    Raises:
        ModelError: A gap is not smooth; the message names the contact and the alternatives.
    """
    parts = [block.part for block in system.layout.having(Kind.CONE)]
    pairs = ((part.name, getattr(part, "pair", None)) for part in parts)
    rough = [f"{name} ({pair.why_not})" for name, pair in pairs if pair and not pair.is_smooth]
    if rough:
        raise ModelError(
            f"integrator {type_name(type(method))} locates events, which requires smooth gaps; "
            f"not smooth: {', '.join(rough)}; accepted: moreau_jean, or points on one of the "
            "bodies over a half_space or over spheres"
        )


def _world_axes_stepper(method: Integrator, system: System, dt: float) -> Stepper:
    """Prepare a stepper that integrates velocities of free bodies in the axes of the world."""
    from mbd_ros.core.dynamics.world_axes import InWorldAxes
    from mbd_ros.methods.integration.adapted_steps import TurnedSteps

    world = InWorldAxes(system)
    inner = prepare_stepper(method, world, dt)
    return inner if method.turns else TurnedSteps(world, inner)
