"""Steps of a system, each of them checked, corrected and counted.

`CheckedSteps` is what simulations are made of. A step that leaves the finite numbers is an error
that names what is lost and the last finite state; `Overshoots` sees joints pass their stops.
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
_COUNTED = 1.0e150  # whose squares are numbers
_IN_REACH = 1.0e6  # rad or m: where a mass matrix still says something of the robot
_SAID = 1.0e-4  # rad or m; what steps that resolve an impact leave is far below
_KEPT = ("_first", "_worst", "_limit", "_speed", "_when", "_seen")


class CheckedSteps:
    """Takes steps of a system, keeps its rows, and knows what happened.

    Args:
        system: As for `Simulation`.
        integrator: As for `Simulation`.
        stabilization: As for `Simulation`.
        dt: As for `Simulation` [s].

    Attributes:
        steps: Steps taken so far.
        worst: Largest condition number of the rows after a step, inf where they are redundant,
            and its time [s]. Beyond some 1e6, near a toggle, multipliers are unreliable.
        overshoots: How far joints went beyond their stops; None without any.
        guards: Names of what may happen at one time, in the order of the scene.
        switches: Names of what a mode has an entry for, in that order.
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
        self.stepper = stepper_of(integrator, system, dt)
        self.system: System = self.stepper.system or system
        self.guards = self.stepper.guards
        self.switches = self.stepper.switches
        self.steps = 0
        self.worst = (1.0, 0.0)
        has_stops = any(block.part.stops for block in system.layout.smoothed)
        self.overshoots = Overshoots(system) if has_stops else None
        several = phased(system)
        systems = (system,) if several is None else several.systems
        has_rows = any(one.bilateral.rows for one in systems)
        self._is_corrected = has_rows and not integrator.keeps_constraints
        self._nz = system.internals.nz
        self._made_by = integrator.title, dt, system.nq, system.nv, self._nz
        self._evaluations = self.system.evaluations  # before the start
        self._began: tuple[State, State] | None = None

    def _assembled(self, x: State) -> State:
        """The nearest consistent state; that of the last start where it began from here, too."""
        if self._began is not None and is_same(x, self._began[0]):
            return self._began[1]
        y = consistent_start(during(self.system, x), x)
        self._began = x, y
        return y

    def _corrected(self, y: State) -> State:
        """The state after a step, on the rows."""
        if not self._is_corrected:
            return y
        system = during(self.system, y)
        corrected = self.stabilization.correct(system, y)
        if system.condition > self.worst[0]:
            self.worst = system.condition, y.t
        return corrected

    def _step(self, y: State, u: Array | None, end: float, most: int = 1) -> State:
        """One step, or up to `most` that nothing looks at in between."""
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
                self.overshoots.look(y, after)
            return after
        raise divergence(self.system, y, after)

    @property
    def evaluations(self) -> int:
        """How often accelerations were computed so far."""
        own = self.stepper.evaluations if isinstance(self.stepper, BlockStepper) else 0
        return self.system.evaluations - self._evaluations + own

    @property
    def events(self) -> list[Event]:
        """What happened since the start or the last `take_events`, in the order of time."""
        return list(self.stepper.events)

    def take_events(self) -> tuple[Event, ...]:
        """The same, and forget it: a simulation without end has no list without end."""
        return tuple(self.stepper.take_events())

    def take_residuals(self) -> Residuals | None:
        """The worst residuals of contacts in steps since the last call; None without contacts."""
        worst: Residuals | None = self.stepper.residuals
        self.stepper.forget_residuals()
        return worst

    def passed_stops(self) -> list[str]:
        """Joints that went beyond stops since the start, one text each."""
        return [] if self.overshoots is None else [str(one) for one in self.overshoots.found()]


def divergence(system: System, y: State, after: State) -> DivergedError:
    """The error of a step from a finite state to one that is not."""
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
        return f"{', '.join(names[:_SHOWN])} beyond all numbers"
    return "positions or velocities are beyond all numbers"


def _advice(system: System, y: State) -> str:
    try:
        if np.abs(y.q).max(initial=0.0) < _IN_REACH:  # else rounding speaks, not the robot
            check_mass(system, y.q)
    except SolveError as error:
        return str(error)
    return "try a smaller dt"


def last_finite(system: System, y: State) -> str:
    """The fastest joint or free body, time and positions of the last finite state."""
    x, robot = system.expand(y), system.robot
    speeds = {joint.name: (float(x.v[joint.v]), "joint") for joint in robot.joints}
    places = [f"{joint.name} {x.q[joint.q]:.4g}" for joint in robot.joints[:_SHOWN]]
    for base in robot.bases:
        from mbd_ros.core.kinematics.poses import world_pose  # only where something flies

        fastest = max(x.v[base.v].tolist(), key=abs)
        speeds[base.name] = fastest, "free body"
        place = world_pose(robot, x.q[base.q])[:3]
        places.append(f"{base.name} {', '.join(f'{one:.4g}' for one in place.tolist())}")
    name = max(speeds, key=lambda one: abs(speeds[one][0]))
    speed, kind = speeds[name]
    more = ", .." if len(speeds) > _SHOWN else ""
    return (
        f"last finite state at t = {y.t:.9g} s: fastest {kind} {name} with {speed:.3g}/s; "
        f"positions {', '.join(places[:_SHOWN])}{more}"
    )


class Overshoots:
    """The largest overshoot at every end of every stop of a system.

    A stop that acts before its end is reached is not passed. A stop that a step jumps over is.
    Steps in which no bounded row acts cost nothing.

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
        """Forget all; ends that the first state is beyond do not count."""
        self._first = np.maximum(self._outwards(y) - self._ends, 0.0)
        self._speed, self._when = np.zeros((2, len(self._ends)))
        self._worst, self._limit, self._seen = self._first, self._ends + self._first, y

    def checkpoint(self) -> Memory:
        """What was seen so far, as a value of its own."""
        return {name: copied(getattr(self, name)) for name in _KEPT}

    def restore(self, checkpoint: Memory, y: Any) -> None:
        """Go on from a checkpoint; y is the state from which the next step starts."""
        for name, value in checkpoint.items():
            setattr(self, name, recognised(copied(value), y))

    def look(self, y: Any, y_next: Any) -> None:
        """Look at a step, from one state of the integrated coordinates to the next."""
        if not self._system.bounded.acts:
            return
        if y is not self._seen:  # a stop may act only in the step after that which passed it
            self._compare(y, y)
        self._compare(y_next, y)
        self._seen = y_next

    def found(self) -> list[Overshoot]:
        """Those that are large enough to report: lower ends, then upper ones, as the stops."""
        return [
            Overshoot(
                self._joints[i],
                float(self._signs[i] * self._ends[i]),
                float(self._worst[i]),
                float(self._when[i]),
                float(self._speed[i]),
            )
            for i in np.flatnonzero(self._worst - self._first > _SAID).tolist()
        ]

    def _outwards(self, y: Any) -> Array:
        """Positions of the joints in the direction of every end, shape (2 n,)."""
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
    """A joint beyond a stop.

    Attributes:
        end: The end that it passed [rad or m].
        size: How far it went [rad or m].
        t: When it was there [s].
        speed: Its largest speed at the start of the steps that took it there [rad/s or m/s].
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
            f"at t = {self.t:.6g} s, coming with up to {self.speed:.3g} {unit}/s"
        )


def stepper_of(method: Integrator, system: System, dt: float) -> Stepper:
    """The steps of a method, from event to event where a scene has any.

    Args:
        system: What it integrates.
        dt: Length of a step, or first guess [s].

    Raises:
        ModelError: The method cannot stop at events, or surfaces stand beside smoothed rows; or it
            cannot move internal states; names them.
    """
    if (several := phased(system)) is not None:
        from mbd_ros.methods.events.phases import PhaseSteps

        return PhaseSteps(several, lambda one: stepper_of(method, one, dt))
    rows, guards = happenings(system)
    surfaces = method.finds_surfaces and any(force.surfaces for force in system.loads.forces)
    if not (guards or surfaces) and (method.at_velocity_level or not rows):
        return prepared(method, system, dt)
    if not method.event_driven:
        way_out = "; or smoothed: true at these constraints" if rows and not guards else ""
        raise ModelError(
            f"integrator {method.title} does not stop at events, which exact rows and "
            f"guards need: {', '.join((*rows, *guards))}; accepted: rk4, dopri5, dop853, "
            f"filippov, gauss_legendre, adams, and moreau_jean without guards{way_out}"
        )
    _refuse_kinks(method, system)
    from mbd_ros.methods.events.event_steps import EventSteps
    from mbd_ros.methods.events.mode_field import ModeField

    field = ModeField(system, surfaces)
    steps = method.event_steps or EventSteps
    if field.has_contacts and not system.chart.is_flat:
        return steps(field, _turned(method, field.system, dt), dt)
    return steps(field, prepared(method, field.system, dt), dt)


def happenings(system: System) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the exact rows that give way, and of parts with guards."""
    rows = () if system.event_rows is None else tuple(system.event_rows.names)
    return rows, tuple(part.name for part in _parts(system) if part.guards)


def _parts(system: System) -> Iterator[Part]:
    yield from system.loads.actuators
    yield from system.loads.forces
    yield from (block.part for block in system.layout.blocks)
    yield from system.loads.watching


def prepared(method: Integrator, system: System, dt: float) -> Stepper:
    """The steps of a method, internal states included."""
    if not system.internals.nz or method.at_velocity_level or method.moves_internal:
        return method.prepare(system, dt)
    if not method.keeps_internal:
        names = ", ".join(filter(None, system.internals.names))
        raise ModelError(
            f"integrator {type_name(type(method))} does not move internal states, the scene has "
            f"{names}; accepted: any other, such as rk4"
        )
    from mbd_ros.methods.integration.adapted_steps import InternalSteps

    return InternalSteps(method, system, dt)


def _refuse_kinks(method: Integrator, system: System) -> None:
    """Refuse contacts whose gaps are not smooth where events have to be found.

    Raises:
        ModelError: Names them, and the way out.
    """
    parts = [block.part for block in system.layout.having(Kind.CONE)]
    pairs = ((part.name, getattr(part, "pair", None)) for part in parts)
    rough = [f"{name} ({pair.why_not})" for name, pair in pairs if pair and not pair.is_smooth]
    if rough:
        raise ModelError(
            f"integrator {type_name(type(method))} goes from event to event, which needs smooth "
            f"gaps; not so {', '.join(rough)}; accepted: moreau_jean, or points on one of the "
            "bodies over a half_space or over spheres"
        )


def _turned(method: Integrator, system: System, dt: float) -> Stepper:
    """The steps of a method in the axes of the world, where spins turn no velocity."""
    from mbd_ros.core.dynamics.world_axes import InWorldAxes
    from mbd_ros.methods.integration.adapted_steps import TurnedSteps

    world = InWorldAxes(system)
    inner = prepared(method, world, dt)
    return inner if method.turns else TurnedSteps(world, inner)
