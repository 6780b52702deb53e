"""Forward dynamics of an open chain with inertia that loads add: (M + M_f) a + h = tau."""

import eigenpy

from mbd_ros.core.dynamics.aba import Aba
from mbd_ros.core.dynamics.free_motion import writing
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.state import Array


class Dense(Aba):
    """Acceleration from state and inputs by a factorised mass matrix.

    Args:
        mechanism: What moves.

    Attributes:
        mechanism: As given.
        coordinates: All joints.
    """

    tier = "dense"

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__(mechanism)
        self._factor = eigenpy.LLT(int(mechanism.model.nv))

    def accelerate(self, t: float, q: Array, v: Array, u: Array | None) -> Array:
        """Accelerations of all joints, shape (nv,)."""
        mechanism = self.mechanism
        mechanism.evaluations += 1
        tau = mechanism.tau(t, q, v, u) - mechanism.bias(q, v)
        self._factor.compute(mechanism.mass(q))
        a: Array = self._factor.solve(tau)
        return a

    def accelerator(self) -> Accelerator:
        """The function that writes what `accelerate` returns."""
        return writing(self.accelerate)
