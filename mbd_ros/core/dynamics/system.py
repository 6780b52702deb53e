"""The contract of the equations of motion of a scene, for integrators, controllers and jobs.

    M a + h = tau + J' lam,   J a + drift = 0 of bilateral rows,   laws of the other rows

`System` is their contract. A system is composed of a `FreeMotion` in some `Coordinates` and of
unilateral and bounded rows (`composed_system`); `tiers` chooses its formulation. Functions for
systems that may have phases follow at the end; they cost nothing where there are none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mass import Mass
from mbd_ros.core.dynamics.mechanism import Mechanism, RigidRows
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowLayout
from mbd_ros.core.rows.delassus import RowFactor, UsualSizes
from mbd_ros.core.state import NONE, Array, Evaluation, Mode, State

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.event_rows import EventRows

# t, q, v, u and what is written; with internal states t, q, v, z, u and what is written, a and z'
Accelerator = Callable[..., None]
Acceleration = Callable[[State, Array | None], Array]  # of a state of what is integrated, and u
_new_state = tuple.__new__  # half the time of the constructor


class System(Protocol):
    """The equations of motion of a scene in one tier.

    States x are those of all joints. A tier that eliminates joints integrates fewer coordinates,
    called y: `chart`, `accelerator`, `derivatives`, `mass`, `applied` and the rows are in y.

    Attributes:
        tier: Name of the formulation.
        model: Its Pinocchio model.
        loads: Loads on its joints.
        k: Kinematics at the last evaluated state.
        nq: Size of the configuration of y.
        nv: Size of its velocity.
        internals: The internal states of its parts: z.
        rows: Bilateral rows of positions, which an integrator may have to keep.
        constraints: The same, stacked.
        bilateral: All bilateral rows, those of velocities included: velocities and accelerations
            keep them, positions need not. Equal to `rows` where no row states velocities.
        bounded: Bounded rows that are solved for in every evaluation, None without any.
        event_rows: Unilateral and bounded rows whose mode changes at events only; None without
            any.
        layout: The rows of the multipliers of an `Evaluation`.
        multiplier_rows: The same as a list, in the same order under every tier.
        sizes: Characteristic sizes of masses and these rows; None without rows.
        condition: Condition number of `bilateral` in the mass metric when last factorised, for
            reports; 1 without rows.
    """

    tier: str
    robot: Robot
    model: Any
    loads: Loads
    k: Kinematics
    chart: Chart
    nq: int
    nv: int
    internals: Internals
    rows: tuple[Row, ...]
    constraints: ConstraintRows
    bilateral: RigidRows
    bounded: BoundedRows | None
    event_rows: EventRows | None
    layout: RowLayout
    multiplier_rows: tuple[Row, ...]
    sizes: UsualSizes | None

    @property
    def condition(self) -> float:
        """Condition number of `bilateral` when last factorised."""

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the equations of motion."""

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Return accelerations, multipliers and the response to forces, at a state of all joints.

        Args:
            x: State of all joints; tiers that eliminate some read the others.
            u: Inputs; None stands for those of the sources, or for safe values without sources.

        Raises:
            SolveError: The equations have no solution.
        """

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function of t, q, v, u that writes y'' in a mode, shape (nv,).

        With internal states it is one of t, q, v, z, u that writes y'' and z', shape (nz,).
        """

    def rates(self, y: State, u: Array | None = None) -> Array:
        """Return rates z' of the internal states at a state of what is integrated, shape (nz,)."""

    def at_rest(self, y: State, u: Array | None = None) -> Array:
        """Internal states with what parts know of their equilibrium, NaN where none is known."""

    def derivatives(self, y: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Return derivatives of y'' at a state of what is integrated.

        Args:
            y: State of what is integrated.
            u: As for `evaluate`.
            inputs: Whether those by u are wanted; their shape is (nv, 0) otherwise.
        """

    def with_loads(self, loads: Loads) -> System:
        """Return the same robot and rows, built for other loads."""

    def with_gains(self, kp: float, kd: float) -> System:
        """Return the same system with g'' + kd g' + kp g = 0 of bilateral rows.

        Args:
            kp: Gain of positions [1/s^2].
            kd: Gain of velocities [1/s].
        """

    def expand(self, y: State) -> State:
        """Return the state of all joints from that of what is integrated."""

    def reduce(self, x: State) -> State:
        """Return the state of what is integrated from that of all joints."""

    def lift(self, y: State, a: Array) -> Array:
        """Accelerations of all joints from the y'' at a state, fresh, shape (nv of the robot,)."""

    def integrated(self, a: Array) -> Array:
        """Return those of what is integrated among values of all joints."""

    def mass(self, q: Array) -> Mass:
        """Mass matrix as an operator: products, solutions, and entries for who needs them."""

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Return the generalized force tau - h without the constraints, shape (nv,)."""

    def applied_with(self, y: State, u: Array | None = None) -> Array:
        """Return the same at a state with internal states."""

    def residual(self, t: float, q: Array) -> Array:
        """Return g(t, q) of `rows`, shape (m,)."""

    def jacobian(self, t: float, q: Array) -> Array:
        """Return dg/dq, shape (m, nv)."""

    def rate(self, t: float, q: Array) -> Array:
        """Return dg/dt, shape (m,)."""

    def factorise(self, t: float, q: Array) -> RowFactor:
        """Return the factor of `rows`; brings `condition` up to date."""

    def energy(self, y: State) -> float:
        """Return the kinetic and potential energy [J]; heights are counted from `Robot.origin`."""


class Derivatives(NamedTuple):
    """Derivatives of the accelerations y'' of what is integrated.

    Attributes:
        q: By steps in the tangent of the configuration, shape (nv, nv).
        v: By the velocity, shape (nv, nv).
        z: By the internal states, shape (nv, nz).
        u: By the inputs, shape (nv, nu).
        rates: The same of the rates z', (nz,) instead of (nv,); None without internal states.
        p: By the parameters of a compiled system, shape (nv, np); None where it is not compiled.
        force: By generalized forces on all joints, shape (nv, nv of the robot); None where that
            did not come with the others.
    """

    q: Array
    v: Array
    z: Array
    u: Array
    rates: Derivatives | None = None
    p: Array | None = None
    force: Array | None = None

    @property
    def of_velocities(self) -> tuple[Array, Array]:
        """Derivatives of (y'', z') by (y, nothing) and by (y', z), shape (nv + nz, nv + nz)."""
        if self.rates is None:
            return self.q, self.v
        none = np.zeros((len(self.q) + self.z.shape[1], self.z.shape[1]))
        by_q = np.hstack((np.vstack((self.q, self.rates.q)), none))
        return by_q, np.block([[self.v, self.z], [self.rates.v, self.rates.z]])


class FreeMotion(Protocol):
    """Accelerations y'' under bilateral rows and couplings, without unilateral and bounded rows.

    Attributes:
        tier: Name of the formulation.
        coordinates: The integrated coordinates.
    """

    tier: str
    mechanism: Mechanism

    @property
    def coordinates(self) -> Coordinates:
        """The integrated coordinates and their relation to all joints."""

    def accelerate(self, y: State, u: Array | None) -> Array:
        """Return y'' at a state, shape (nv,); the next call may overwrite it.

        Args:
            y: State with internal states inside their bounds, and with the mode for the loads.
            u: Inputs, as for `System.evaluate`.
        """

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function of t, q, v, u that writes the result of `accelerate` in a mode."""

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return q, v and a of all joints from y and y'' at the state of the last `accelerate`."""

    def respond(self, q: Array, forces: Array) -> Array:
        """Return accelerations of all joints that forces on them add at the last `accelerate`.

        Args:
            q: Configuration of y there.
            forces: One generalized force a column, shape (nv of the robot, k).

        Returns:
            Shape (nv of the robot, k).
        """

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Return accelerations of all joints, and multipliers of couplings and rigid rows, fresh.

        Args:
            y: State of the last `accelerate`.
            a: y'' with all rows.
            force: What rows that give way exert, shape (nv of the robot,); None without any.
        """


class Coordinates(Protocol):
    """The integrated coordinates y and their relation to all joints."""

    chart: Chart

    def expand(self, y: State) -> State:
        """Return the state of all joints."""

    def reduce(self, x: State) -> State:
        """Return the state of y."""

    def lift(self, y: State, a: Array) -> Array:
        """Return accelerations of all joints from y'', fresh, shape (nv of the robot,)."""

    def integrated(self, a: Array) -> Array:
        """Return those of y among values of all joints."""

    def mass(self, q: Array) -> Array:
        """Return the mass matrix of y, shape (nv, nv), overwritten by the next call."""

    def applied(self, y: State, u: Array | None) -> Array:
        """Return the generalized force tau - h on y, shape (nv,)."""


def writing(accelerate: Acceleration, mode: Mode = ()) -> Accelerator:
    """Return a function of t, q, v, u that writes accelerations into its fifth argument.

    Args:
        accelerate: The accelerations at a state.
        mode: Mode of the states.
    """

    def write(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
        out[...] = accelerate(_new_state(State, (t, q, v, NONE, mode)), u)

    return write


def evaluation_at(system: System, y: State) -> Callable[[], None]:
    """Return an evaluation of accelerations and rates in the mode of a state, for clocks.

    Args:
        y: State of what it integrates.
    """
    t, q, v, z, mode = y
    accelerate, out = system.accelerator(mode), (np.zeros(system.nv), np.zeros(len(z)))
    if not system.internals.nz:
        return lambda: accelerate(t, q, v, None, out[0])
    return lambda: accelerate(t, q, v, z, None, *out)


def phased(system: System) -> Any:
    """Return the system as a `PhasedSystem`; None where it has no phases."""
    return system if getattr(system, "phases", ()) else None


def during(system: System, x: State) -> System:
    """Return the system of the phase of a state; the system itself where it has no phases."""
    several = phased(system)
    return system if several is None else several.during(x)


def inward(system: System, x: State) -> State:
    """Return the state with the mode that the system of its phase has for it."""
    several = phased(system)
    return x if several is None else several.inward(x)


def phase_names(system: System) -> tuple[str, ...]:
    """Return names of the phases in the order of the scene; empty where it has none."""
    several = phased(system)
    return () if several is None else tuple(phase.name for phase in several.phases)
