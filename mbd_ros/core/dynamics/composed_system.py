"""Accelerations of a scene: a free motion, and the rows that give way on top of it.

    y'' = free(t, q, v, u) + response of y'' to J' lam

The free motion keeps bilateral rows and couplings (`open_chain`, `reduced`, `kkt`). The
multipliers lam of unilateral and bounded rows come from `complementarity/bounded_rows`, in every
evaluation, or from `contact_modes/event_rows`, where rows are active or not by the mode of the
state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.dynamics.linearization import Linearization, mode_at
from mbd_ros.core.dynamics.mass import Mass
from mbd_ros.core.dynamics.mechanism import RigidRows
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, FreeMotion, System
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.constraint_rows import RowLayout
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import NONE, Array, Evaluation, Mode, State
from mbd_ros.errors import SolveError

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.event_rows import ExactRows
    from mbd_ros.core.dynamics.internal_dynamics import Extended
    from mbd_ros.core.dynamics.linearization import FreeDerivatives

Build = Callable[[Loads, tuple[float, float]], System]


class ComposedSystem:
    """Free motion + response to forces + solver of the rows that give way; see `System`.

    Args:
        motion: Accelerations without rows that give way.
        rigid: Rows of positions that an integrator may have to keep, whoever solves for them.
        held: The same with rows of velocities; the same object without any.
        bounded: Rows with bounded multipliers that are solved for in every evaluation, by Gauss's
            principle.
        exact: Rows with bounded multipliers that are on or off by the mode, beside those above.
        layout: All rows of the scene.
        internals: The internal states of all parts.
        build: Makes the same system for other loads and gains.
    """

    def __init__(
        self,
        motion: FreeMotion,
        rigid: RigidRows,
        held: RigidRows,
        bounded: BoundedRows | None,
        exact: ExactRows | None,
        layout: RowLayout,
        internals: Internals,
        build: Build,
    ) -> None:
        self._motion = motion
        self._rigid = rigid
        self._build = build
        self._mechanism = motion.mechanism
        coordinates = motion.coordinates
        self.held, self.coordinates = held, coordinates  # of what is integrated, and all joints
        self.tier = motion.tier
        self.chart = coordinates.chart
        self.robot = self._mechanism.robot
        self.loads = self._mechanism.loads
        self.model = self._mechanism.model
        self.k = self._mechanism.k
        self.nq = self.chart.nq
        self.nv = self.chart.nv
        self.bounded = bounded
        self.exact = exact
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
        self.applied = coordinates.applied
        self.rows: tuple[Row, ...] = rigid.rows
        self.multiplier_rows: tuple[Row, ...] = layout.rows
        solved = np.ones(len(layout.rows), dtype=np.bool_)
        self._given = bounded if exact is None else exact.solver
        if self._given is not None:
            solved[self._given.constraints.slots] = False
        self._solved = np.flatnonzero(solved)
        self._accelerators = ModeAccelerators(motion, bounded, exact, internals, self._rates)
        self._whole: Extended | None = None
        self._free: FreeDerivatives | None = None
        if internals.nz:
            from mbd_ros.core.dynamics import internal_dynamics as extended

            self._whole = extended.Extended(self)
        self._integrated = self if self._whole is None else self._whole

    @property
    def condition(self) -> float:
        """Condition number of the rows in the mass metric when last factorised."""
        return self.held.condition

    @property
    def evaluations(self) -> int:
        """How often the equations of motion were asked."""
        return self._mechanism.evaluations

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Accelerations, multipliers and the response to forces; as `System.evaluate`."""
        mechanism, internals = self._mechanism, self.internals
        mechanism.mode = x.mode
        try:
            if not internals.nz:
                return self._evaluated(x, u)
            internals.check(x.z)
            mechanism.z = internals.inside(x.z)
            zdot = self._rates(x._replace(z=mechanism.z), u)
            return self._evaluated(x, u)._replace(zdot=zdot)
        finally:
            mechanism.mode, mechanism.z = (), NONE

    def _evaluated(self, x: State, u: Array | None) -> Evaluation:
        motion, given, y = self._motion, self._given, self.coordinates.reduce(x)
        a, force = motion.accelerate(y.t, y.q, y.v, u), None
        if self.exact is not None:
            a = self.exact.accelerate(y.t, y.q, y.v, a, x.mode)
        elif given is not None:
            a = given.accelerate(motion, y.t, y.q, y.v, a)
        if given is not None:
            force = given.force
        a, lam = motion.solution(y, u, a, force)
        if given is not None:
            free, lam = lam, np.empty(len(self.multiplier_rows))
            lam[self._solved], lam[given.constraints.slots] = free, given.multipliers
        return Evaluation(x, a, NONE, lam, self._response(y))

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """The function that writes y'' in a mode, and z' with internal states; made once."""
        return self._accelerators.of(mode)

    def rates(self, y: State, u: Array | None = None) -> Array:
        """Rates z' of the internal states, shape (nz,)."""
        x = self.coordinates.expand(y)
        return self._rates(x._replace(z=self.internals.inside(y.z)), u)

    def at_rest(self, y: State, u: Array | None = None) -> Array:
        """Internal states where they are given or parts know their equilibrium, else NaN."""
        if not np.isnan(y.z).any():
            return y.z
        internals, k, x = self.internals, self._mechanism.k, self.coordinates.expand(y)
        k.refresh(x.q, x.v, internals.reads)
        return internals.at_rest(k, x, self.loads.inputs(x, u))

    def applied_with(self, y: State, u: Array | None = None) -> Array:
        """Generalized force tau - h at a state with internal states, shape (nv,)."""
        mechanism = self._mechanism
        before, mechanism.z = mechanism.z, self.internals.inside(y.z)
        try:
            return self.applied(y.t, y.q, y.v, u)
        finally:
            mechanism.z = before

    def derivatives(self, y: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Derivatives of y'', to about 1e-6 by differences; as `System.derivatives`."""
        if self.tier == "aba" and self.bounded is None and self.exact is None:
            if self._free is None:
                from mbd_ros.core.dynamics.linearization import FreeDerivatives

                self._free = FreeDerivatives(self._mechanism, self.chart, self.internals)
            return self._free.at(y, u, inputs=inputs)
        field = self._integrated.accelerator(mode_at(self, y, u))
        linear = Linearization(self._integrated, field)
        if self._whole is None:
            return linear.derivatives(y, u, inputs=inputs)
        n, x = self.nv, self._whole.joined(y)
        by_q, by_v, _, by_u, *_ = linear.derivatives(x, u, inputs=inputs)
        rates = Derivatives(by_q[n:, :n], by_v[n:, :n], by_v[n:, n:], by_u[n:])
        return Derivatives(by_q[:n, :n], by_v[:n, :n], by_v[:n, n:], by_u[:n], rates)

    def with_loads(self, loads: Loads) -> System:
        """The same robot and rows, built for other loads."""
        return self._build(loads, self.constraints.gains)

    def with_gains(self, kp: float, kd: float) -> System:
        """The same system, with g'' + kd g' + kp g = 0 of rigid rows; itself if it has them."""
        if (kp, kd) == self.constraints.gains:
            return self
        return self._build(self.loads, (kp, kd))

    def mass(self, q: Array) -> Mass:
        """Mass matrix of what is integrated, as an operator."""
        return Mass(self.coordinates.mass(q))

    def factorise(self, t: float, q: Array) -> RowFactor:
        """Factor of the bilateral rows of positions; brings `condition` up to date."""
        J = self._rigid.jacobian(t, q)
        return self._rigid.factorise(self.coordinates.mass(q), J)

    def energy(self, y: State) -> float:
        """Kinetic and potential energy [J]; heights are counted from `Robot.origin`."""
        return self._mechanism.energy(self.coordinates.expand(y))

    def _response(self, y: State) -> Callable[[Array], Array]:
        """The response to forces at a state that was just evaluated, until the next one."""
        stamp = self._mechanism.evaluations

        def respond(forces: Array) -> Array:
            if self._mechanism.evaluations != stamp:
                raise SolveError("respond was asked after a later evaluation of its system")
            self.coordinates.expand(y)
            return self._motion.respond(y.q, forces)

        return respond

    def _rates(self, x: State, u: Array | None) -> Array:
        """The z' at a state of all joints, internal states inside their bounds."""
        internals, k, loads = self.internals, self._mechanism.k, self.loads
        k.refresh(x.q, x.v, internals.reads)
        return internals.rates(k, x, loads.inputs(x, u))


class ModeAccelerators:
    """Accelerators of a `ComposedSystem`, made once a mode.

    Args:
        motion: Accelerations without rows that give way.
        bounded: Rows that are solved for in every evaluation.
        exact: Rows that are on or off by the mode.
        internals: The internal states of all parts.
        rates: Rates of internal states at a state of all joints.
    """

    def __init__(
        self,
        motion: FreeMotion,
        bounded: BoundedRows | None,
        exact: ExactRows | None,
        internals: Internals,
        rates: Callable[[State, Array | None], Array],
    ) -> None:
        self._motion = motion
        self._mechanism = motion.mechanism
        self._bounded = bounded
        self._exact = exact
        self._internals = internals
        self._rates = rates
        self._made = dict[Mode, Accelerator]()

    def of(self, mode: Mode) -> Accelerator:
        """The function that writes y'' in a mode, and z' with internal states."""
        if mode not in self._made:
            self._made[mode] = self._written(mode)
        return self._made[mode]

    def _written(self, mode: Mode) -> Accelerator:
        mechanism, write = self._mechanism, self._without_exact()
        if self._exact is not None and not self._exact.is_idle(mode):
            write = self._with_exact(self._exact, mode)
        if self._internals.nz:
            return self._with_rates(write, mode)
        if not mode or mechanism.loads.is_empty:  # nobody reads the mode
            return write

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            mechanism.mode = mode
            try:
                write(t, q, v, u, out)
            finally:
                mechanism.mode = ()

        return accelerate

    def _with_rates(self, write: Accelerator, mode: Mode) -> Accelerator:
        mechanism, inside, rates = self._mechanism, self._internals.inside, self._rates
        expand, is_constant = self._motion.coordinates.expand, self._internals.is_constant

        def accelerate(
            t: float, q: Array, v: Array, z: Array, u: Array | None, a_out: Array, z_out: Array
        ) -> None:
            before = mechanism.mode, mechanism.z
            mechanism.mode, mechanism.z = mode, inside(z)
            try:
                if is_constant:
                    z_out[...] = 0.0
                else:
                    z_out[...] = rates(expand(State(t, q, v, mechanism.z, mode)), u)
                write(t, q, v, u, a_out)
            finally:
                mechanism.mode, mechanism.z = before

        return accelerate

    def _with_exact(self, exact: ExactRows, mode: Mode) -> Accelerator:
        motion, pushed = self._motion, exact.pushing(mode)

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            a = motion.accelerate(t, q, v, u)
            if pushed is None:
                out[...] = exact.accelerate(t, q, v, a, mode, splits=False)
            else:
                out[...] = pushed(t, q, v, a)

        return accelerate

    def _without_exact(self) -> Accelerator:
        motion, bounded = self._motion, self._bounded
        if bounded is None:
            return motion.accelerator()

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            a = motion.accelerate(t, q, v, u)
            out[...] = bounded.accelerate(motion, t, q, v, a)

        return accelerate
