"""Forward dynamics with bilateral rows: one factorised solve.

    M a + h = tau + J' lam,   J a + drift = -kd g' - kp g

The multipliers follow from (J M^-1 J') lam = -(J M^-1 (tau - h) + drift + kd g' + kp g). Pinocchio
factorises J M^-1 J' while the rows are independent beyond doubt; redundant rows, and rows near a
toggle, go through its eigenvalues instead. Every answer is checked by J a + drift. Source: R.
Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 3.2 and 8.5.
"""

from functools import partial

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.mechanism import Mechanism, RigidRows
from mbd_ros.core.dynamics.open_chain import AllJoints
from mbd_ros.core.dynamics.system import Accelerator, writing
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import HELD_BY_ROWS, NEAR_TOGGLE
from mbd_ros.errors import SolveError

_multiply, _bias = np.multiply, pin.nonLinearEffects
_FACTORISED = eigenpy.ComputationInfo.Success
_REGULAR = NEAR_TOGGLE**-2.0
_EXACT = 1.0e-20  # square of the accepted residual of the rows, relative


class Kkt:
    """Accelerations of all joints; rigid rows hold by multipliers.

    A Cholesky factorisation solves it; redundant rows, and rows near a toggle, go through their
    eigenvalues instead.
    """

    tier = "kkt"

    def __init__(self, mechanism: Mechanism, rigid: RigidRows) -> None:
        self.mechanism = mechanism
        self._rigid = rigid
        self.coordinates = AllJoints(mechanism)
        self._constraints = rigid.constraints
        self._loads = mechanism.loads
        self._reads = max(rigid.constraints.reads, mechanism.loads.reads)
        model, data = mechanism.model, mechanism.data
        self._crba = partial(pin.crba, model, data)
        self._bias = partial(_bias, model, data)
        self._forward = partial(pin.forwardDynamics, model, data)
        m, nv, sizes = len(rigid.rows), int(mechanism.model.nv), rigid.sizes
        self._row_jacobian = np.zeros((m, nv))
        self._lam: Array | None = None
        self._weights = sizes.weights if sizes else np.zeros((m, nv))
        self._weighted = np.zeros((m, nv))
        self._gram = np.zeros((m, m))
        self._square = partial(self._weighted.dot, self._weighted.T, self._gram)
        self._is_single = m == 1
        self._is_pair = m == 2
        self._cholesky = eigenpy.LLT(m)
        self._least = 0.0 if sizes is None else _REGULAR * float(sizes.square.min())

    def accelerate(self, y: State, u: Array | None, added: Array | None = None) -> Array:
        """Return the accelerations under the loads and an added force.

        The next call overwrites them.
        """
        mechanism, constraints = self.mechanism, self._constraints
        _, q, v, _, _ = y
        mechanism.evaluations += 1
        k = mechanism.k
        if self._reads:
            k.refresh(q, v, self._reads)
        if constraints.is_corrected:
            J, drift = constraints.conditions(k, y)
        else:
            J, drift = constraints.accelerations(k, y)
        tau = mechanism.zero if self._loads.is_empty else self._loads.total(k, y, u)
        if added is not None:
            tau = tau + added
        self._row_jacobian, self._lam = J, None
        if self._is_regular(J):
            self._crba(q)
            self._bias(q, v)
            a = self._forward(tau, J, drift, 0.0)
            left = J.dot(a)
            left += drift
            off = left.dot(left)
            if off <= _EXACT or off <= _EXACT * drift.dot(drift):
                return a
            a = self._refined(a, J, left)
            left = J.dot(a)
            left += drift
            off = left.dot(left)
            if off <= _EXACT or off <= _EXACT * drift.dot(drift):
                return a
        a, self._lam = self._by_rank(q, v, tau, J, drift)
        return a

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function that writes the result of `accelerate` in a mode."""
        return writing(self.accelerate, mode)

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the same q, v and a."""
        return q, v, a

    def respond(self, q: Array, forces: Array) -> Array:
        """Return accelerations that forces add while the rows hold, shape as `forces`."""
        M, J = self.mechanism.mass(q), self._row_jacobian
        factor = self._rigid.factorise(M, J)
        free = np.linalg.solve(M, forces)
        moved = free - factor.motion(J.dot(free))
        is_held_still = np.abs(moved).max(axis=0) <= HELD_BY_ROWS * np.abs(free).max(axis=0)
        moved[:, is_held_still] = 0.0
        return moved

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Return accelerations and multipliers of the rows."""
        if force is not None:
            a = self.accelerate(y, u, force)
        a = np.array(a)
        return a, np.array(self.mechanism.data.lambda_c) if self._lam is None else self._lam

    def _refined(self, a: Array, J: Array, left: Array) -> Array:
        """Accelerations without what rounding has left of the rows where masses are very unequal.

        Source: N. Higham, Accuracy and Stability of Numerical Algorithms, 2002, ch. 12.
        """
        data = self.mechanism.data
        a, lam = np.array(a), np.array(data.lambda_c)
        a += self._forward(np.array(data.nle), J, left, 0.0)
        self._lam = lam + data.lambda_c
        return a

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

    def _by_rank(
        self, q: Array, v: Array, tau: Array, J: Array, drift: Array
    ) -> tuple[Array, Array]:
        M = self.mechanism.mass(q)
        free = np.linalg.solve(M, tau - self.mechanism.bias(q, v))
        factor = self._rigid.factorise(M, J)
        moved = J.dot(free)
        r = -(moved + drift)
        row = factor.contradiction(r, drift, float(free.dot(M.dot(free))) ** 0.5)
        if row is not None:
            name = self._rigid.rows[row].name
            raise SolveError(f"constraint row {name} contradicts the other rows")
        lam = factor.solve(r)
        return free + factor.X.dot(lam), lam
