"""Accelerations of a scene: a free motion, with unilateral and bounded constraints on top of it.

    y'' = free(t, q, v, u) + response of y'' to J' lam

The free motion keeps bilateral rows and couplings (`open_chain`, `reduced`, `kkt`). The
multipliers lam of unilateral and bounded rows come from `complementarity/bounded_rows`, in every
evaluation, or from `contact_modes/event_rows`, where rows are active or not by the mode of the
state. `step` has the same equations on one screen.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.dynamics.linearization import Linearization, mode_at
from mbd_ros.core.dynamics.mass import Mass
from mbd_ros.core.dynamics.mechanism import RigidRows
from mbd_ros.core.dynamics.system import (
    Acceleration,
    Accelerator,
    Derivatives,
    FreeMotion,
    System,
    writing,
)
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.constraint_rows import RowLayout
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import NONE, Array, Evaluation, Mode, State
from mbd_ros.errors import SolveError

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.event_rows import EventRows
    from mbd_ros.core.dynamics.internal_dynamics import Extended
    from mbd_ros.core.dynamics.linearization import FreeDerivatives

Build = Callable[[Loads, tuple[float, float]], System]


class ComposedSystem:
    """A `System` of a free motion, its response to forces, and a solver of bounded multipliers.

    Args:
        motion: Accelerations without unilateral and bounded rows.
        rigid: Bilateral rows on positions, which an integrator may have to keep.
        bilateral: The same with bilateral rows on velocities; the same object without any.
        bounded: Rows with bounded multipliers that are solved for in every evaluation, by Gauss's
            principle.
        event_rows: Rows with bounded multipliers that are active by the mode, beside those above.
        layout: All rows of the scene.
        internals: The internal states of all parts.
        build: Builds the same system for other loads and gains.
    """

    def __init__(
        self,
        motion: FreeMotion,
        rigid: RigidRows,
        bilateral: RigidRows,
        bounded: BoundedRows | None,
        event_rows: EventRows | None,
        layout: RowLayout,
        internals: Internals,
        build: Build,
    ) -> None:
        self._motion = motion
        self._rigid = rigid
        self._build = build
        self._mechanism = motion.mechanism
        coordinates = motion.coordinates
        self.bilateral = bilateral
        self.coordinates = coordinates
        self.tier = motion.tier
        self.chart = coordinates.chart
        self.robot = self._mechanism.robot
        self.loads = self._mechanism.loads
        self.model = self._mechanism.model
        self.k = self._mechanism.k
        self.nq = self.chart.nq
        self.nv = self.chart.nv
        self.bounded = bounded
        self.event_rows = event_rows
        self.layout = layout
        self.internals = internals
        self.constraints = rigid.constraints
        self.sizes = rigid.sizes
        self.residual = rigid.residual
        self.jacobian = rigid.jacobian
        self.rate = rigid.rate
        self.expand = coordinates.expand
        self.reduce = coordinates.reduce
        self.lift = coordinates.lift
        self.integrated = coordinates.integrated
        self.rows: tuple[Row, ...] = rigid.rows
        self.multiplier_rows: tuple[Row, ...] = layout.rows
        is_rigid = np.ones(len(layout.rows), dtype=np.bool_)
        self._solver = bounded if event_rows is None else event_rows.solver
        if self._solver is not None:
            is_rigid[self._solver.constraints.slots] = False
        self._rigid_slots = np.flatnonzero(is_rigid)
        self._accelerators = ModeAccelerators(motion, bounded, event_rows, internals, self._rates)
        self._extended: Extended | None = None
        self._free: FreeDerivatives | None = None
        if internals.nz:
            from mbd_ros.core.dynamics import internal_dynamics

            self._extended = internal_dynamics.Extended(self)
        self._integrated = self if self._extended is None else self._extended

    @property
    def condition(self) -> float:
        """Condition number of the rows in the mass metric when last factorised."""
        return self.bilateral.condition

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the equations of motion."""
        return self._mechanism.evaluations

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Return accelerations, multipliers and the response to forces at a state."""
        internals = self.internals
        if not internals.nz:
            return self._evaluate(x, u)
        internals.check(x.z)
        inside = x._replace(z=internals.inside(x.z))
        zdot = self._rates(inside, u)
        return self._evaluate(inside, u)._replace(x=x, zdot=zdot)

    def _evaluate(self, x: State, u: Array | None) -> Evaluation:
        motion, y = self._motion, self.coordinates.reduce(x)
        a = motion.accelerate(y, u)
        if self._solver is None:
            a, lam = motion.solution(y, u, a, None)
            return Evaluation(x, a, NONE, lam, self._response(y))
        if self.event_rows is not None:
            a, bounded_lam, force, *_ = self.event_rows.accelerate(y, a)
        else:
            a, bounded_lam, force, *_ = self._solver.accelerate(motion, y, a)
        lam = np.empty(len(self.multiplier_rows))
        a, lam[self._rigid_slots] = motion.solution(y, u, a, force)
        lam[self._solver.constraints.slots] = bounded_lam
        return Evaluation(x, a, NONE, lam, self._response(y))

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """The function that writes y'' in a mode, and z' with internal states; made once."""
        return self._accelerators.of(mode)

    def rates(self, y: State, u: Array | None = None) -> Array:
        """Return rates z' of the internal states, shape (nz,)."""
        x = self.coordinates.expand(y)
        return self._rates(x._replace(z=self.internals.inside(y.z)), u)

    def at_rest(self, y: State, u: Array | None = None) -> Array:
        """Internal states where they are given or parts know their equilibrium, else NaN."""
        if not np.isnan(y.z).any():
            return y.z
        internals, k, x = self.internals, self._mechanism.k, self.coordinates.expand(y)
        k.refresh(x.q, x.v, internals.reads)
        return internals.at_rest(k, x, self.loads.inputs(x, u))

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Return the generalized force tau - h without the constraints, shape (nv,)."""
        return self.coordinates.applied(State(t, q, v), u)

    def applied_with(self, y: State, u: Array | None = None) -> Array:
        """Return the generalized force tau - h at a state with internal states, shape (nv,)."""
        inside = State(y.t, y.q, y.v, self.internals.inside(y.z))
        return self.coordinates.applied(inside, u)

    def derivatives(self, y: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Return derivatives of y'', to about 1e-6 by differences."""
        if self.tier == "aba" and self.bounded is None and self.event_rows is None:
            if self._free is None:
                from mbd_ros.core.dynamics.linearization import FreeDerivatives

                self._free = FreeDerivatives(self._mechanism, self.chart, self.internals)
            return self._free.at(y, u, inputs=inputs)
        field = self._integrated.accelerator(mode_at(self, y, u))
        linear = Linearization(self._integrated)
        if self._extended is None:
            return linear.derivatives(field, y, u, inputs=inputs)
        n, x = self.nv, self._extended.joined(y)
        by_q, by_v, _, by_u, *_ = linear.derivatives(field, x, u, inputs=inputs)
        rates = Derivatives(by_q[n:, :n], by_v[n:, :n], by_v[n:, n:], by_u[n:])
        return Derivatives(by_q[:n, :n], by_v[:n, :n], by_v[:n, n:], by_u[:n], rates)

    def with_loads(self, loads: Loads) -> System:
        """Return the same robot and rows, built for other loads."""
        return self._build(loads, self.constraints.gains)

    def with_gains(self, kp: float, kd: float) -> System:
        """Return the same system with g'' + kd g' + kp g = 0 of bilateral rows."""
        if (kp, kd) == self.constraints.gains:
            return self
        return self._build(self.loads, (kp, kd))

    def mass(self, q: Array) -> Mass:
        """Return the mass matrix of what is integrated, as an operator."""
        return Mass(self.coordinates.mass(q))

    def factorise(self, t: float, q: Array) -> RowFactor:
        """Return the factor of the bilateral rows of positions; brings `condition` up to date."""
        J = self._rigid.jacobian(t, q)
        return self._rigid.factorise(self.coordinates.mass(q), J)

    def energy(self, y: State) -> float:
        """Return the kinetic and potential energy [J]; heights are counted from `Robot.origin`."""
        return self._mechanism.energy(self.coordinates.expand(y))

    def _response(self, y: State) -> Callable[[Array], Array]:
        """Return the response to forces at a state that was just evaluated, until the next one."""
        stamp = self._mechanism.evaluations

        def respond(forces: Array) -> Array:
            if self._mechanism.evaluations != stamp:
                raise SolveError("respond was asked after a later evaluation of its system")
            self.coordinates.expand(y)
            return self._motion.respond(y.q, forces)

        return respond

    def _rates(self, x: State, u: Array | None) -> Array:
        """Return z' at a state of all joints, internal states inside their bounds."""
        internals, k, loads = self.internals, self._mechanism.k, self.loads
        k.refresh(x.q, x.v, internals.reads)
        return internals.rates(k, x, loads.inputs(x, u))


class ModeAccelerators:
    """Accelerators of a `ComposedSystem`, made once a mode.

    Args:
        motion: Accelerations without unilateral and bounded rows.
        bounded: Bounded rows that are solved for in every evaluation.
        event_rows: Rows that are active by the mode.
        internals: The internal states of all parts.
        rates: Rates of internal states at a state of all joints.
    """

    def __init__(
        self,
        motion: FreeMotion,
        bounded: BoundedRows | None,
        event_rows: EventRows | None,
        internals: Internals,
        rates: Callable[[State, Array | None], Array],
    ) -> None:
        self._motion = motion
        self._mechanism = motion.mechanism
        self._bounded = bounded
        self._event_rows = event_rows
        self._internals = internals
        self._rates = rates
        self._made = dict[Mode, Accelerator]()

    def of(self, mode: Mode) -> Accelerator:
        """Return the function that writes y'' in a mode, and z' with internal states."""
        if mode not in self._made:
            self._made[mode] = self._accelerator(mode)
        return self._made[mode]

    def _accelerator(self, mode: Mode) -> Accelerator:
        accelerate = self._acceleration(mode)
        if self._internals.nz:
            return self._with_rates(accelerate, mode)
        if accelerate == self._motion.accelerate:
            return self._motion.accelerator(mode)
        return writing(accelerate, mode)

    def _acceleration(self, mode: Mode) -> Acceleration:
        """Return the function from a state in a mode, and u, to y''."""
        motion, bounded, rows = self._motion, self._bounded, self._event_rows
        if rows is not None and not rows.is_idle(mode):
            add_forces = rows.bound_forces(mode)
            if add_forces is not None:
                return lambda y, u: add_forces(y, motion.accelerate(y, u))
            return lambda y, u: rows.accelerate(y, motion.accelerate(y, u), splits=False).a
        if bounded is not None:
            return lambda y, u: bounded.accelerate(motion, y, motion.accelerate(y, u)).a
        return motion.accelerate

    def _with_rates(self, accelerate: Acceleration, mode: Mode) -> Accelerator:
        rates, inside = self._rates, self._internals.inside
        expand, is_constant = self._motion.coordinates.expand, self._internals.is_constant

        def write(
            t: float, q: Array, v: Array, z: Array, u: Array | None, a_out: Array, z_out: Array
        ) -> None:
            y = State(t, q, v, inside(z), mode)
            z_out[...] = 0.0 if is_constant else rates(expand(y), u)
            a_out[...] = accelerate(y, u)

        return write
