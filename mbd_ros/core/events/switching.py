"""Contract of forces that jump at surfaces."""

import numpy as np

from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import Array, State


class DiscontinuousForce(Load):
    """A force that is smooth except where h_i(t, q, v) = 0.

        tau = blend(signs),   signs_i = sign h_i off the surfaces, in -1 .. 1 on them

    `blend` is affine in `signs`, and with fixed signs smooth across the surfaces. So the convex
    combination of Filippov, the equivalent control of Utkin and the multilinear blend of the 2^k
    sides are one and the same motion.

    Source: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, §4.

    Attributes:
        surfaces: Names of the surfaces, for messages.
    """

    surfaces: tuple[str, ...]

    def heights(self, k: Kinematics, x: State) -> Array:
        """The h_i, shape (k,); in any unit."""
        raise NotImplementedError

    def rates(self, k: Kinematics, x: State, a: Array) -> Array:
        """The dh_i/dt, affine in the acceleration, shape (k,).

        Args:
            k: Kinematics at the state.
            x: State.
            a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        """
        raise NotImplementedError

    def blend(self, k: Kinematics, x: State, signs: Array) -> Array:
        """Generalized force between the sides [N·m or N], shape (nv,).

        Args:
            k: Kinematics at the state.
            x: State.
            signs: One a surface, shape (k,): 1 above it, -1 below.
        """
        raise NotImplementedError

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """The force by the signs of the heights, for methods without surfaces, shape (nv,)."""
        return self.blend(k, x, np.sign(self.heights(k, x)))

    def beside(self, k: Kinematics, x: State) -> Load:
        """The force with the signs of a state everywhere; on a surface itself the mean of both."""
        return OneSide(self, np.sign(self.heights(k, x)))


class OneSide(Load):
    """A switching force that does not switch.

    Args:
        force: The force.
        signs: The side, one sign a surface, shape (k,).
    """

    def __init__(self, force: DiscontinuousForce, signs: Array) -> None:
        self._force, self._signs, self.reads = force, signs, force.reads

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force [N·m or N], shape (nv,)."""
        return self._force.blend(k, x, self._signs)
