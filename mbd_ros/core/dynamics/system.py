"""Forward dynamics of an open chain: M(q) a + h(q, v) = tau."""

from collections.abc import Callable
from functools import partial

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.bounded_rows import BoundedRows
from mbd_ros.core.parts import Row, Wrench
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_factor import RowFactor
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.rows.usual_sizes import usual_sizes
from mbd_ros.core.state import NONE, Array, Evaluation, State
from mbd_ros.errors import SolveError

Accelerator = Callable[[float, Array, Array, Array | None, Array], None]  # the last one is written


def writing(acceleration: Callable[[float, Array, Array, Array | None], Array]) -> Accelerator:
    """A function of t, q, v, u that writes its result into a fifth argument, shape (nv,)."""

    def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
        out[...] = acceleration(t, q, v, u)

    return accelerate


class System:
    """Acceleration from state and command by the articulated-body algorithm.

    The base of the other tiers. One instance owns one Pinocchio `Data`: not for two threads.
    Pinocchio's algorithms use their local convention, the default; in that of the world rounding
    grows with the distance from its origin.

    Args:
        robot: The robot.
        loads: What acts on its joints.
        constraints: Bilateral rows; this class solves for none, but gives their violation.
        bounded: Rows with bounded multipliers, solved for by Gauss's principle.
        layout: All rows of the scene; those of `bounded` without it.

    Attributes:
        tier: Name of the way of solving.
        chart: Of the configuration that is integrated.
        nq: Size of that configuration.
        nv: Size of its velocity.
        rows: Bilateral rows that an integrator may have to keep.
        layout: Which multipliers of an `Evaluation` are those of which rows.
        multiplier_rows: What they are, in the same order under every tier.
        evaluations: How often the acceleration was asked for.
        sizes: What masses and bilateral rows usually are; None without rows.
        condition: Condition number of the rows in the mass metric when last factorised, for
            reports; 1 without rows.
    """

    tier = "aba"

    def __init__(
        self,
        robot: Robot,
        loads: Loads,
        constraints: ConstraintRows | None = None,
        bounded: BoundedRows | None = None,
        layout: RowLayout | None = None,
    ) -> None:
        self.robot, self.loads = robot, loads
        self.constraints = constraints or ConstraintRows((), robot.model.nv)
        self.bounded = bounded
        self.model, self.data = robot.model, pin.Data(robot.model)
        self.k = Kinematics(robot, self.data)
        self.chart = Chart(robot.model)
        self.nq, self.nv = self.chart.nq, self.chart.nv
        self.rows: tuple[Row, ...] = self.constraints.rows
        parts = () if bounded is None else bounded.constraints.parts
        self.layout = layout or RowLayout(parts)
        self.multiplier_rows: tuple[Row, ...] = self.layout.rows
        self.evaluations = 0
        self.condition = 1.0
        self._zero = np.zeros(self.model.nv)
        self._aba = partial(pin.aba, self.model, self.data)
        self._is_free = loads.is_empty and bounded is None
        self.sizes = usual_sizes(self) if self.rows else None

    def acceleration(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Acceleration of the integrated coordinates [rad/s^2 or m/s^2], shape (nv,)."""
        self.evaluations += 1
        if self._is_free:
            return self._aba(q, v, self._zero)
        a = self._aba(q, v, self._tau(t, q, v, u))
        return a if self.bounded is None else self.bounded.accelerate(self, t, q, v, a)

    def accelerator(self) -> Accelerator:
        """`acceleration` for loops that keep its results."""
        return writing(self.acceleration)

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Accelerations and multipliers at a state of all joints.

        Args:
            x: State of all joints; tiers that eliminate some read the others.
            u: Inputs; None stands for what sources give, else for safe values.

        Raises:
            SolveError: The equations have no solution.
        """
        y = self.reduce(x)
        a, lam = self._solve(y, u)
        stamp = self.evaluations

        def respond(forces: Array) -> Array:
            if self.evaluations != stamp:
                raise SolveError("respond was asked after a later evaluation of its system")
            self.expand(y)
            return self.respond(y.q, forces)

        return Evaluation(x, a, NONE, lam, respond)

    def wrenches(self, x: State, multipliers: Array) -> tuple[Wrench, ...]:
        """Wrenches of bilateral constraints on bodies.

        Args:
            x: State of all joints.
            multipliers: Those of `evaluate` at this state.
        """
        if not self.rows:
            return ()
        self.k.refresh(x.q, x.v, min(self.constraints.reads, Reads.POSITION))
        return self.constraints.wrenches(self.k, x, multipliers[self.constraints.slots])

    def mass(self, q: Array) -> Array:
        """Mass matrix of the integrated coordinates, symmetric, shape (nv, nv)."""
        return self._full_mass(q)

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Generalized force tau - h without the constraints, shape (nv,)."""
        self.evaluations += 1
        return self._tau(t, q, v, u) - pin.nonLinearEffects(self.model, self.data, q, v)

    def residual(self, t: float, q: Array) -> Array:
        """g(t, q) of the bilateral rows, shape (m,)."""
        return self.constraints.residual(self.k, self._placed(t, q, Reads.POSITION))

    def jacobian(self, t: float, q: Array) -> Array:
        """dg/dq, shape (m, nv)."""
        return self.constraints.jacobian(self.k, self._placed(t, q, Reads.JACOBIAN))

    def rate(self, t: float, q: Array) -> Array:
        """dg/dt, shape (m,)."""
        return self.constraints.rate(self.k, State(t, q, self._zero))

    def factorise(self, M: Array, J: Array) -> RowFactor:
        """Factor of the bilateral rows; brings `condition` up to date.

        Args:
            M: Mass matrix, shape (nv, nv).
            J: Jacobian of the rows, shape (m, nv).
        """
        factor = RowFactor(M, J, None if self.sizes is None else self.sizes.mobility)
        self.condition = factor.condition
        return factor

    def correct_rows(self, kp: float, kd: float) -> None:
        """Demand g'' + kd g' + kp g = 0 of the bilateral rows; kp [1/s^2], kd [1/s]."""
        self.constraints.correct_rigid_rows(kp, kd)
        if self.bounded is not None:
            self.bounded.constraints.correct_rigid_rows(kp, kd)

    def expand(self, x: State) -> State:
        """State of all joints from that of the integrated coordinates."""
        return x

    def reduce(self, x: State) -> State:
        """State of the integrated coordinates from that of all joints."""
        return x

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """q, v and a of all joints at the state of the last evaluation."""
        return q, v, a

    def integrated(self, a: Array) -> Array:
        """Accelerations of the integrated coordinates among those of all joints."""
        return a

    def respond(self, q: Array, forces: Array) -> Array:
        """Accelerations of all joints that forces on them add, constraints kept.

        Args:
            q: Configuration of the integrated coordinates at the last evaluation.
            forces: One generalized force a column, shape (nv of the robot, k).

        Returns:
            Shape (nv of the robot, k).
        """
        return eigenpy.LLT(self._full_mass(q)).solve(forces).reshape(forces.shape)

    def energy(self, x: State) -> float:
        """Kinetic and potential energy [J] at a state; heights are counted from `Robot.origin`."""
        full = self.expand(x)
        stored = float(pin.computeMechanicalEnergy(self.model, self.data, full.q, full.v))
        self.k.refresh(full.q, full.v, min(self.loads.reads, Reads.POSITION))
        return stored + self.loads.potential(self.k, full)

    def _solve(self, y: State, u: Array | None) -> tuple[Array, Array]:
        """Accelerations of all joints and multipliers, fresh."""
        a = np.array(self.acceleration(y.t, y.q, y.v, u))
        return a, NONE if self.bounded is None else self.bounded.multipliers.copy()

    def _tau(self, t: float, q: Array, v: Array, u: Array | None) -> Array:
        """Loads at a state of all joints."""
        if self.loads.is_empty:
            return self._zero
        self.k.refresh(q, v, self.loads.reads)
        return self.loads.total(self.k, State(t, q, v), u)

    def _joined(self, rigid: Array) -> Array:
        """Multipliers of all rows at the last evaluation, from those of the rigid ones."""
        multipliers = np.zeros(len(self.multiplier_rows))
        multipliers[self.constraints.slots] = rigid
        if self.bounded is not None:
            multipliers[self.bounded.constraints.slots] = self.bounded.multipliers
        return multipliers

    def _placed(self, t: float, q: Array, reads: Reads) -> State:
        """State at rest of all joints, with k as far as the rows and what is asked read it."""
        self.k.refresh(q, self._zero, min(self.constraints.reads, reads))
        return State(t, q, self._zero)

    def _full_mass(self, q: Array) -> Array:
        return pin.crba(self.model, self.data, q)
