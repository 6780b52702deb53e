"""Forward dynamics with bilateral rows: one factorised solve.

M a + h = tau + J' lam,   J a + drift = -kd g' - kp g
"""

from functools import partial

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.bounded_rows import BoundedRows
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import HELD_BY_ROWS, NEAR_TOGGLE
from mbd_ros.errors import SolveError

_multiply = np.multiply
_FACTORISED = eigenpy.ComputationInfo.Success
_REGULAR = NEAR_TOGGLE**-2.0
_EXACT = 1.0e-20  # square of the accepted residual of the rows, relative


class BilateralSystem(System):
    """Integrates all joints; constraint rows hold by multipliers.

    A Cholesky factorisation solves it; redundant rows, and rows near a toggle, go through their
    eigenvalues instead.

    Args:
        robot: The robot.
        loads: What acts on its joints.
        constraints: The rows.
        bounded: Rows with bounded multipliers.
        layout: All rows of the scene; those of `constraints` without it.
    """

    tier = "kkt"

    def __init__(
        self,
        robot: Robot,
        loads: Loads,
        constraints: ConstraintRows,
        bounded: BoundedRows | None = None,
        layout: RowLayout | None = None,
    ) -> None:
        layout = layout or RowLayout(constraints.parts)
        super().__init__(robot, loads, constraints, bounded, layout)
        self._reads = max(constraints.reads, loads.reads)
        m = len(constraints.rows)
        self._row_jacobian = np.zeros((m, self.nv))
        self._lam: Array | None = None
        self._weights = self.sizes.weights if self.sizes else np.zeros((m, self.nv))
        self._weighted, self._gram = np.zeros((m, self.nv)), np.zeros((m, m))
        self._square = partial(self._weighted.dot, self._weighted.T, self._gram)
        self._is_single, self._is_pair, self._cholesky = m == 1, m == 2, eigenpy.LLT(m)
        self._least = 0.0 if self.sizes is None else _REGULAR * float(self.sizes.square.min())

    def acceleration(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,)."""
        a = self._accelerate(t, q, v, u)
        return a if self.bounded is None else self.bounded.accelerate(self, t, q, v, a)

    def respond(self, q: Array, forces: Array) -> Array:
        """Accelerations of all joints that forces on them add; as `System.respond`."""
        M, J = self._full_mass(q), self._row_jacobian
        factor = self.factorise(M, J)
        free = np.linalg.solve(M, forces)
        moved = free - factor.motion(J.dot(free))
        held = np.abs(moved).max(axis=0) <= HELD_BY_ROWS * np.abs(free).max(axis=0)
        moved[:, held] = 0.0
        return moved

    def _accelerate(
        self, t: float, q: Array, v: Array, u: Array | None, added: Array | None = None
    ) -> Array:
        """Accelerations with bilateral rows alone, under the loads and an added force."""
        self.evaluations += 1
        data, constraints, x = self.data, self.constraints, State(t, q, v)
        self.k.refresh(q, v, self._reads)
        if constraints.is_corrected:
            J, drift = constraints.conditions(self.k, x)
        else:
            J, drift = constraints.accelerations(self.k, x)
        tau = self._zero if self.loads.is_empty else self.loads.total(self.k, x, u)
        if added is not None:
            tau = tau + added
        self._row_jacobian, self._lam = J, None
        if self._is_regular(J):
            pin.crba(self.model, data, q)
            pin.nonLinearEffects(self.model, data, q, v)
            a = pin.forwardDynamics(self.model, data, tau, J, drift, 0.0)
            left = J.dot(a)
            left += drift
            off = left.dot(left)
            if off <= _EXACT or off <= _EXACT * drift.dot(drift):
                return a
        a, self._lam = self._by_rank(q, v, tau, J, drift)
        return a

    def _solve(self, y: State, u: Array | None) -> tuple[Array, Array]:
        a = self._accelerate(y.t, y.q, y.v, u)
        if self.bounded is None:
            return np.array(a), self._multipliers()
        self.bounded.accelerate(self, y.t, y.q, y.v, a)
        a = self._accelerate(y.t, y.q, y.v, u, self.bounded.force)
        return np.array(a), self._joined(self._multipliers())

    def _is_regular(self, J: Array) -> bool:
        """Whether rows are independent beyond doubt, by the usual masses."""
        if self._is_single:
            row = J[0]
            return bool(row.dot(row) > self._least)
        _multiply(J, self._weights, self._weighted)
        gram = self._square()
        if self._is_pair:
            a, b, _, c = gram.ravel().tolist()
            return bool(a > _REGULAR and a * c - b * b > _REGULAR * a)
        self._cholesky.compute(gram)
        return bool(self._cholesky.info() == _FACTORISED and self._cholesky.rcond() > _REGULAR)

    def _multipliers(self) -> Array:
        """Those of the last `_accelerate`, fresh."""
        return np.array(self.data.lambda_c) if self._lam is None else self._lam

    def _by_rank(
        self, q: Array, v: Array, tau: Array, J: Array, drift: Array
    ) -> tuple[Array, Array]:
        M = self._full_mass(q)
        free = np.linalg.solve(M, tau - pin.nonLinearEffects(self.model, self.data, q, v))
        factor = self.factorise(M, J)
        moved = J.dot(free)
        r = -(moved + drift)
        row = factor.contradiction(r, drift, float(free.dot(M.dot(free))) ** 0.5)
        if row is not None:
            raise SolveError(f"constraint row {self.rows[row].name} contradicts the other rows")
        lam = factor.solve(r)
        return free + factor.X.dot(lam), lam
