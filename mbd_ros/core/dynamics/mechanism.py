"""A robot with its loads and bilateral rows, and its response to impulses.

    Mechanism        M a + h = tau           all joints under loads, and the Pinocchio `Data`
    RigidRows        g(t, q) = 0             bilateral rows, which hold with any multiplier
    ImpulseResponse  M (v+ - v) = J' p       while bilateral rows keep J_b v+ = goal

The formulations of accelerations, and time steps in which velocities jump, are composed of them.
"""

from copy import copy

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.delassus import RowFactor, UsualSizes, usual_sizes
from mbd_ros.core.state import Array, State


class Mechanism:
    """All joints under loads; owns one Pinocchio `Data`: not for two threads.

    Pinocchio's algorithms use their local convention, the default; in that of the world rounding
    grows with the distance from its origin.

    Args:
        loads: Loads on its joints.

    Attributes:
        model: The Pinocchio model.
        data: Its `Data`.
        k: Kinematics over `data`.
        zero: Zero velocity or force, shape (nv,), read-only.
        evaluations: Number of evaluations of the equations of motion.
    """

    def __init__(self, robot: Robot, loads: Loads) -> None:
        self.robot = robot
        self.loads = loads
        self.model = robot.model
        self.data = pin.Data(robot.model)
        self.k = Kinematics(robot, self.data)
        self.zero: Array = np.zeros(self.model.nv)
        self.evaluations = 0

    def tau(self, x: State, u: Array | None) -> Array:
        """Return the force of the loads at a state of all joints, shape (nv,), read-only."""
        if self.loads.is_empty:
            return self.zero
        self.k.refresh(x.q, x.v, self.loads.reads)
        return self.loads.total(self.k, x, u)

    def mass(self, q: Array) -> Array:
        """Mass matrix of all joints, symmetric, shape (nv, nv), overwritten by the next call."""
        M: Array = pin.crba(self.model, self.data, q)
        if not self.loads.heavy:
            return M
        x = self.placed(0.0, q, self.loads.reads)
        return M + sum(load.inertia(self.k, x) for load in self.loads.heavy)

    def added(self, q: Array, a: Array) -> Array:
        """Return what accelerations ask of inertia that loads add, shape (nv,)."""
        x = self.placed(0.0, q, self.loads.reads)
        return sum((load.inertia(self.k, x).dot(a) for load in self.loads.heavy), self.zero)

    def bias(self, q: Array, v: Array) -> Array:
        """Return h of M a + h = tau, shape (nv,), overwritten by the next call."""
        return pin.nonLinearEffects(self.model, self.data, q, v)

    def placed(self, t: float, q: Array, reads: Reads) -> State:
        """Return the state at rest of all joints, with k as far as it is read."""
        self.k.refresh(q, self.zero, reads)
        return State(t, q, self.zero)

    def energy(self, x: State) -> float:
        """Return the kinetic and potential energy [J] at a state of all joints."""
        stored = float(pin.computeMechanicalEnergy(self.model, self.data, x.q, x.v))
        self.k.refresh(x.q, x.v, min(self.loads.reads, Reads.POSITION))
        for load in self.loads.heavy:
            stored += 0.5 * float(x.v.dot(load.inertia(self.k, x)).dot(x.v))
        return stored + self.loads.potential(self.k, x)


class RigidRows:
    """g(t, q) = 0 of all joints.

    Args:
        sizes: Characteristic sizes of masses and rows, where they are known.

    Attributes:
        rows: One entry a row.
        sizes: Characteristic sizes of masses and rows; None without rows.
        condition: Condition number of the rows in the mass metric when last factorised, for
            reports; 1 without rows.
    """

    def __init__(
        self, mechanism: Mechanism, constraints: ConstraintRows, sizes: UsualSizes | None = None
    ) -> None:
        self._mechanism = mechanism
        self.constraints = constraints
        self.rows: tuple[Row, ...] = constraints.rows
        self._of_g, self._of_J = (
            min(constraints.reads, reads) for reads in (Reads.POSITION, Reads.JACOBIAN)
        )
        self.condition = 1.0
        self.sizes = sizes
        if sizes is None and self.rows:
            self.sizes = usual_sizes(mechanism.robot, self._at)
        self._usual = None if self.sizes is None else self.sizes.mobility

    def residual(self, t: float, q: Array) -> Array:
        """Return g(t, q), shape (m,); 0 for rows of velocities."""
        x = self._mechanism.placed(t, q, self._of_g)
        return self.constraints.residual(self._mechanism.k, x)

    def jacobian(self, t: float, q: Array) -> Array:
        """Return dg/dq, shape (m, nv), fresh."""
        x = self._mechanism.placed(t, q, self._of_J)
        return self.constraints.jacobian(self._mechanism.k, x)

    def rate(self, t: float, q: Array) -> Array:
        """Return dg/dt, shape (m,)."""
        return self.constraints.rate(self._mechanism.k, State(t, q, self._mechanism.zero))

    def factorise(self, M: Array, J: Array) -> RowFactor:
        """Return the factor of the rows; brings `condition` up to date.

        Args:
            M: Mass matrix, shape (nv, nv).
            J: Jacobian of the rows, shape (m, nv).
        """
        factor = RowFactor(M, J, self._usual)
        self.condition = factor.condition
        return factor

    def factor_at(self, t: float, q: Array) -> RowFactor:
        """Return the factor at a configuration of all joints; brings `condition` up to date."""
        J = self.jacobian(t, q)
        return self.factorise(self._mechanism.mass(q), J)

    def _at(self, q: Array) -> tuple[Array, Array]:
        return self._mechanism.mass(q), self.jacobian(0.0, q)


_PROJECTIONS = 2  # the second one takes what rounding leaves where rows hold most of a motion


class ImpulseResponse:
    """Changes of the velocity M^-1 J' p, without what bilateral rows J_b v = goal forbid.

    Args:
        M: Mass matrix, or what stands for it, symmetric, shape (nv, nv).
        J: Rows with impulses, shape (m, nv); None where they follow by `of`.
        hold: Bilateral rows, shape (m_b, nv).
        factor: Their factor in the metric of M; None without any.

    Attributes:
        X: Changes of the velocity by each impulse, shape (nv, m).
        A: Changes of the rates of the rows, shape (m, m).
        loose: Diagonal of A without the bilateral rows, shape (m,).
    """

    def __init__(self, M: Array, J: Array | None, hold: Array, factor: RowFactor | None) -> None:
        self._mass = eigenpy.LLT(M)
        self._hold = hold
        self._factor = factor
        if J is not None:
            self._respond(J)

    def of(self, J: Array) -> "ImpulseResponse":
        """Return that of other rows, shape (m, nv), under the same mass and bilateral rows."""
        other = copy(self)
        other._respond(J)
        return other

    @property
    def is_free(self) -> bool:
        """Whether no bilateral row holds."""
        return self._factor is None

    def _respond(self, J: Array) -> None:
        self.X, hold, factor = self.free(J.T), self._hold, self._factor
        self.loose = np.einsum("ij,ji->i", J, self.X)
        self._bilateral_answer = np.zeros((len(hold), len(J)))
        for _ in range(_PROJECTIONS if factor is not None else 0):
            assert factor is not None
            answer = factor.solve(hold.dot(self.X))
            self._bilateral_answer = self._bilateral_answer + answer
            self.X = self.X - factor.X.dot(answer)
        self.A = J.dot(self.X)

    @property
    def G(self) -> Array:
        """The X in the metric of M, A = G' G, shape (nv, m)."""
        upper: Array = self._mass.matrixU()
        return upper.dot(self.X)

    def free(self, impulse: Array) -> Array:
        """Changes of the velocity by impulses on joints that nothing holds, shape as given."""
        v: Array = self._mass.solve(impulse).reshape(impulse.shape)  # eigenpy flattens one column
        return v

    def constrain(self, v: Array, goal: Array) -> tuple[Array, Array]:
        """Return the nearest velocity with J_b v = goal, and the bilateral impulses for it."""
        if self._factor is None:
            return v, goal
        p = self._factor.solve(goal - self._hold.dot(v))
        return v + self._factor.X.dot(p), p

    def bilateral(self, p: Array) -> Array:
        """Return bilateral impulses that answer those of the rows, shape (m_b,)."""
        return -self._bilateral_answer.dot(p)
