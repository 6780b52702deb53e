"""Simulation in real time: it advances tick by tick while commands arrive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbd_ros.core.contracts import FrictionCone, Now, Output, Wrench
from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.dynamics.system import during, phase_names, phased
from mbd_ros.core.kinematics.poses import POSE, TWIST, with_sign_of, world_pose
from mbd_ros.core.model.robot import Base, Joint, Robot
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import DivergedError, MbdError, ModelError, SolveError
from mbd_ros.methods.projection.assembly import Violation, violation
from mbd_ros.methods.simulation.checked_steps import last_finite
from mbd_ros.methods.simulation.safe_command import CommandWatch, SafeCommand
from mbd_ros.methods.simulation.sample_accelerations import accelerations_at
from mbd_ros.methods.simulation.simulation import Simulation

if TYPE_CHECKING:
    from mbd_ros.methods.events.step_events import Event
    from mbd_ros.methods.inverse_dynamics.reactions import SystemReactions
    from mbd_ros.methods.simulation.noisy_sensors import NoisySensors

_NO_TWISTS: Array = np.zeros((0, TWIST))


class LiveSimulation:
    """Simulation of a scene in ticks, with inputs that are constant over each tick.

    Args:
        build: Function that builds the simulation. `reset` calls it again, so that no history
            remains and a replay is bit-identical.
        initial: State of all joints at the start.
        period: Length of a tick [s], a whole number of steps.
        watch: Receives the inputs of all actuators, in their order.
        safe: Safe command of the actuators.
        heard: Slots in u and receivers of other inputs; the remaining inputs have safe values.

    Attributes:
        simulation: The simulation since the last reset.
        showing: Outputs in `Snapshot.shown`, and arrows.
        now: The newest state; after a divergence the last finite one.
        events: Events of the last tick.
        fault: Reason of a divergence; empty without one.

    Raises:
        ModelError: The period is not a multiple of the step.
        MbdError: The mechanism cannot be assembled, or its first state is not finite.
    """

    def __init__(
        self,
        build: Callable[[], Simulation],
        initial: State,
        period: float,
        watch: CommandWatch,
        safe: SafeCommand,
        heard: Sequence[tuple[slice, CommandWatch]] = (),
    ) -> None:
        self._heard = tuple(heard)
        self._build = build
        self._initial = initial
        self._period = period
        self.watch = watch
        self._safe = safe
        self.reset()

    def reset(self) -> None:
        """Return to the initial state, without any history."""
        simulation = self._build()
        robot, dt = simulation.system.robot, simulation.dt
        self._count = round(self._period / dt)
        if self._count < 1 or abs(self._count * dt - self._period) > SAME_TIME * dt:
            raise ModelError(
                f"a tick of {self._period:g} s is not a multiple of the step dt of {dt:g} s; "
                "choose another rate or dt"
            )
        self._q = np.array([joint.q for joint in robot.joints], dtype=np.intp)
        self._v = np.array([joint.v for joint in robot.joints], dtype=np.intp)
        commands = simulation.system.loads.commands
        driven = [robot.joint(name).v for name in commands]
        self._driven = np.array(driven, dtype=np.intp)
        self._selection = np.eye(robot.model.nv)[:, self._driven]
        self.simulation, self.fault, self._steps = simulation, "", 0
        system, loads = simulation.system, simulation.system.loads
        self.showing = Showing(system.k, system.layout, (*loads.actuators, *loads.forces))
        self._reactions: SystemReactions | None = None
        self._commands = sum(len(a.inputs) for a in simulation.system.loads.actuators)
        for watch in self.watches:
            watch.restart()
        self._poses = np.zeros((len(robot.bases), POSE))
        self.events: tuple[Event, ...] = ()
        self._y = simulation.start(self._initial)
        self._x, self._evaluated, self.now = self._observe(self._y, None)

    def tick(self) -> Snapshot:
        """Advance by one period.

        Raises:
            DivergedError: The state or a quantity computed from it is not finite, or was not since
                the last reset. `now` does not change.
            SolveError: The equations have no solution. `now` does not change.
        """
        if self.fault:
            raise DivergedError(f"{self.fault}; reset it first")
        try:
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # a divergence raises an error of its own
                for watch in self.watches:
                    watch.begin(self._period)
                u = self._inputs()
                y = self._y
                for k in range(self._steps + 1, self._steps + self._count + 1):
                    y = self.simulation.advance(y, u, self._initial.t + k * self.simulation.dt)
                x, evaluated, now = self._observe(y, u)
        except (DivergedError, SolveError) as error:
            self.fault = str(error)
            raise
        self._y, self._x, self._evaluated, self.now = y, x, evaluated, now
        self._steps += self._count
        self.events = self.simulation.take_events()
        return now

    @property
    def watches(self) -> tuple[CommandWatch, ...]:
        """Receivers of all inputs."""
        return self.watch, *(watch for _, watch in self._heard)

    @property
    def phase(self) -> str:
        """Name of the phase of the newest state; empty where the scene has none."""
        several = phased(self.simulation.system)
        return "" if several is None else str(several.phases[several.phase(self._y)].name)

    @property
    def begun(self) -> list[str]:
        """Names of the phases that began in the last tick with a change of the phase."""
        names, ends = phase_names(self.simulation.system), [e for e in self.events if e.ends_phase]
        sides = ((one.before.mode[0], one.after.mode[0]) for one in ends)
        return [names[after] for before, after in sides if after != before]

    def violation(self) -> Violation:
        """Return the violation of the bilateral constraints at the newest state."""
        return violation(during(self.simulation.system, self._y), self._y)

    def wrenches(self) -> list[Wrench]:
        """Return the arrows of `showing` at the newest state."""
        return self.showing.wrenches(self._x, *self._evaluated)

    def cones(self) -> list[FrictionCone]:
        """Return the friction cones of `showing` at the newest state."""
        return self.showing.cones_at(self._x, *self._evaluated)

    def measured(self, sensors: NoisySensors, sample: int) -> list[Array]:
        """Return the measurement of each sensor at the newest state.

        Args:
            sensors: Sensors with their noise.
            sample: Number of the sample since the start.
        """
        u, a, lam = self._evaluated
        system, reactions = self.simulation.system, None
        if sensors.needs_reactions:
            if self._reactions is None:
                from mbd_ros.methods.inverse_dynamics.reactions import SystemReactions

                self._reactions = SystemReactions(system)
            reactions = self._reactions.at(self._x, u, a, lam)
        return sensors.at(system, self._x, Now(a, lam, reactions), sample)

    def _inputs(self) -> Array:
        """Return the inputs of this tick, shape (nu,); those of actuators come first."""
        idle, n = self.simulation.system.loads.idle, self._commands
        u = idle.copy()
        if n:
            u[:n] = self.watch.value(self._safe_command)
        for at, watch in self._heard:
            u[at] = watch.value(partial(idle.__getitem__, at))
        return u

    def _safe_command(self) -> Array:
        """Return the safe commands of the actuators."""
        loads = self.simulation.system.loads
        return loads.command(self._safe_torque(), self._x)[: self._commands]

    def _safe_torque(self) -> Array:
        """Return the safe torque of the actuated joints, shape (nu,)."""
        v = self._x.v[self._driven]
        if self._safe.is_zero:
            return np.zeros(len(v))
        now = self.simulation.system.evaluate(self._x)
        response = now.respond(self._selection)[self._driven]
        return self._safe.torque(v, response, self._period)

    def _observe(
        self, y: State, u: Array | None
    ) -> tuple[State, tuple[Array, Array, Array], Snapshot]:
        """Return the state of all joints; inputs, accelerations, multipliers; and a snapshot."""
        system = self.simulation.system
        x = system.expand(y)
        a, lam, _ = accelerations_at(self.simulation, x, u, self.simulation.stepper.forces)
        effort = system.loads.actuator_torque(system.k, x, u)
        evaluated = system.loads.inputs(x, u), a, lam
        outputs = self.showing.at(x, *evaluated)
        bodies = _bodies(system.robot, x, self._poses)
        joints = x.q[self._q], x.v[self._v], a[self._v], effort[self._v]
        now = Snapshot(x.t, *joints, outputs, *bodies)
        for name, values in zip(now._fields[1:], now[1:], strict=True):
            if values.size and not np.isfinite(values).all():
                raise _not_finite(self, name, values, y)
        self._poses = now.poses
        return x, evaluated, now


def _bodies(robot: Robot, x: State, before: Array) -> tuple[Array, Array]:
    """Return poses and twists of the free bodies at a state of all joints."""
    if not robot.bases:
        return before, _NO_TWISTS
    poses = [world_pose(robot, x.q[base.q]) for base in robot.bases]
    signed = [with_sign_of(*pair) for pair in zip(before, poses, strict=True)]
    return np.array(signed), np.array([x.v[base.v] for base in robot.bases])


def _not_finite(live: LiveSimulation, name: str, values: Array, y: State) -> MbdError:
    """Return the error that names the lost quantities and the last finite state."""
    system = live.simulation.system
    things: Sequence[Output | Joint | Base] = system.robot.joints
    if name == "shown":
        things = live.showing.numbers
    elif name in ("poses", "twists"):
        things = system.robot.bases
    rows = values.reshape(len(things), -1)
    lost = ", ".join(
        thing.name for thing, row in zip(things, rows, strict=True) if not np.isfinite(row).all()
    )
    last = last_finite(system, live._y)
    return DivergedError(f"diverged at t = {y.t:.9g} s: {name} of {lost} not finite; {last}")


class Snapshot(NamedTuple):
    """One state of a simulation with the forces that led to it.

    Attributes:
        t: Time [s].
        position: Positions of joints in the order of the robot [rad or m], shape (n,).
        velocity: Velocities of joints [rad/s or m/s], shape (n,).
        acceleration: Accelerations of joints under the command of the last tick [rad/s^2 or
            m/s^2], shape (n,).
        effort: Efforts of the actuators on the joints [N·m or N], shape (n,).
        shown: Outputs of parts, multipliers first, see `LiveSimulation.showing`.
        poses: Poses of the free bodies in the world, with quaternions of continuous sign, shape
            (k, 7).
        twists: Linear, then angular velocity of the free bodies in their axes, shape (k, 6).
    """

    t: float
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    shown: Array
    poses: Array
    twists: Array
