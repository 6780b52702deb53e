"""Forward dynamics with dependent joints eliminated exactly: q = F(y), v = G y'.

G' M G y'' = G' (tau - h - M dG/dt y')
"""

import eigenpy
import numpy as np

from mbd_ros.core.dynamics.free_motion import writing
from mbd_ros.core.dynamics.independent_joints import IndependentJoints
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import Array, State


class Reduced:
    """Accelerations of independent joints, from M and h of all joints.

    Args:
        mechanism: What moves.
        couplings: Its dependent joints.

    Attributes:
        mechanism: As given.
        coordinates: The independent joints.
    """

    tier = "reduced"

    def __init__(self, mechanism: Mechanism, couplings: Couplings) -> None:
        self.mechanism = mechanism
        self.coordinates = joints = IndependentJoints(mechanism, couplings)
        n = joints.chart.nv
        self._at, self._bias, self._G, self._GT = joints.at, joints.bias, joints.G, joints.G.T
        self._q, self._v, self._shape = joints.q, joints.v, (n,)
        self._is_linear, self._minus_GT = joints.is_linear, -joints.G.T
        self._half, self._M = np.zeros((n, mechanism.model.nv)), np.zeros((n, n))
        self._r = np.zeros(n)
        self._cholesky = eigenpy.LLT(n)

    def accelerate(self, t: float, q: Array, v: Array, u: Array | None) -> Array:
        """The y'' [rad/s^2 or m/s^2], shape (nv,), fresh."""
        mechanism, GT = self.mechanism, self._GT
        mechanism.evaluations += 1
        self._at(q, v)
        if mechanism.loads.is_empty:
            if not self._is_linear:
                np.negative(GT, self._minus_GT)
            self._minus_GT.dot(self._bias(), self._r)
        else:
            GT.dot(mechanism.tau(t, self._q, self._v, u) - self._bias(), self._r)
        GT.dot(mechanism.mass(self._q), self._half).dot(self._G, self._M)
        self._cholesky.compute(self._M)
        return self._cholesky.solve(self._r).reshape(self._shape)  # eigenpy has its own for one

    def accelerator(self) -> Accelerator:
        """The function that writes what `accelerate` returns."""
        return writing(self.accelerate)

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """q, v and a of all joints at the state of the last `accelerate`."""
        return self.coordinates.joint_motion(a)

    def respond(self, q: Array, forces: Array) -> Array:
        """G (G' M G)^-1 G' forces, shape as `forces`."""
        reduced = self._GT.dot(forces)
        return self._G.dot(self._cholesky.solve(reduced).reshape(reduced.shape))

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Accelerations of all joints, and multipliers of the couplings."""
        return coupled_solution(self.coordinates, y, u, a, force)


def coupled_solution(
    joints: IndependentJoints, y: State, u: Array | None, a: Array, force: Array | None
) -> tuple[Array, Array]:
    """Accelerations of all joints, and what their couplings exert; as `FreeMotion.solution`."""
    joints.at(y.q, y.v)
    full_a = joints.joint_motion(a)[2]
    needed = joints.needed(y.t, u, full_a)
    if force is not None:
        needed = needed - force
    return full_a, joints.couplings.reduce(needed, joints.slopes)[1]
