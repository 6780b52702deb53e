"""Forward dynamics of an open chain: M(q) a + h(q, v) = tau.

`Aba` solves it by the articulated-body algorithm, `Dense` by a factorised mass matrix where loads
add inertia: (M + M_f) a + h = tau. Both integrate every joint: y is x.
"""

from functools import partial

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Accelerator, writing
from mbd_ros.core.state import NONE, Array, Mode, State


class Aba:
    """Acceleration from state and inputs by the articulated-body algorithm."""

    tier = "aba"

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.coordinates = AllJoints(mechanism)
        self._aba = partial(pin.aba, mechanism.model, mechanism.data)

    def accelerate(self, y: State, u: Array | None) -> Array:
        """Return the accelerations of all joints, shape (nv,); the next call overwrites them."""
        mechanism = self.mechanism
        mechanism.evaluations += 1
        return self._aba(y.q, y.v, mechanism.tau(y, u))

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function that writes the result of `accelerate` in a mode."""
        mechanism, aba, zero = self.mechanism, self._aba, self.mechanism.zero
        if not mechanism.loads.is_empty:
            return writing(self.accelerate, mode)

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            mechanism.evaluations += 1
            out[...] = aba(q, v, zero)

        return accelerate

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the same q, v and a."""
        return q, v, a

    def respond(self, q: Array, forces: Array) -> Array:
        """Return M^-1 forces, shape as `forces`."""
        return eigenpy.LLT(self.mechanism.mass(q)).solve(forces).reshape(forces.shape)

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Return accelerations of all joints, and no multipliers."""
        return np.array(a), NONE


class Dense(Aba):
    """Acceleration from state and inputs by a factorised mass matrix."""

    tier = "dense"

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__(mechanism)
        self._factor = eigenpy.LLT(int(mechanism.model.nv))

    def accelerate(self, y: State, u: Array | None) -> Array:
        """Return the accelerations of all joints, shape (nv,)."""
        mechanism = self.mechanism
        mechanism.evaluations += 1
        tau = mechanism.tau(y, u) - mechanism.bias(y.q, y.v)
        self._factor.compute(mechanism.mass(y.q))
        a: Array = self._factor.solve(tau)
        return a

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function that writes the result of `accelerate` in a mode."""
        return writing(self.accelerate, mode)


class AllJoints:
    """Coordinates of tiers that integrate every joint.

    Attributes:
        chart: Of the configuration.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self.chart = Chart(mechanism.model)
        self.mass = mechanism.mass

    def expand(self, y: State) -> State:
        """Return the same state."""
        return y

    def reduce(self, x: State) -> State:
        """Return the same state."""
        return x

    def lift(self, y: State, a: Array) -> Array:
        """Return the same accelerations, fresh."""
        return np.array(a)

    def integrated(self, a: Array) -> Array:
        """Return the same values."""
        return a

    def applied(self, y: State, u: Array | None) -> Array:
        """Return the generalized force tau - h, shape (nv,)."""
        mechanism = self._mechanism
        mechanism.evaluations += 1
        return mechanism.tau(y, u) - mechanism.bias(y.q, y.v)
