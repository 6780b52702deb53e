"""Contract of forces that jump at surfaces."""

from typing import Any

import numpy as np

from mbd_ros.core.parts import ForceTerm
from mbd_ros.core.state import Array, State


class DiscontinuousForce(ForceTerm):
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

    def heights(self, data: Any, x: State) -> Array:
        """The h_i, shape (k,); in any unit."""
        raise NotImplementedError

    def rates(self, data: Any, x: State, a: Array) -> Array:
        """The dh_i/dt, affine in the acceleration, shape (k,).

        Args:
            data: Pinocchio data, as for `force`.
            x: State.
            a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        """
        raise NotImplementedError

    def blend(self, data: Any, x: State, signs: Array) -> Array:
        """Generalized force between the sides [N·m or N], shape (nv,).

        Args:
            data: Pinocchio data, as for `force`.
            x: State.
            signs: One a surface, shape (k,): 1 above it, -1 below.
        """
        raise NotImplementedError

    def force(self, data: Any, x: State) -> Array:
        """The force by the signs of the heights, for methods without surfaces, shape (nv,)."""
        return self.blend(data, x, np.sign(self.heights(data, x)))

    def beside(self, data: Any, x: State) -> ForceTerm:
        """The force with the signs of a state everywhere; on a surface itself the mean of both."""
        return OneSide(self, np.sign(self.heights(data, x)))


class OneSide(ForceTerm):
    """A switching force that does not switch.

    Args:
        force: The force.
        signs: The side, one sign a surface, shape (k,).
    """

    def __init__(self, force: DiscontinuousForce, signs: Array) -> None:
        self._force, self._signs, self.reads_frames = force, signs, force.reads_frames  # type: ignore[misc]

    def force(self, data: Any, x: State) -> Array:
        """Generalized force [N·m or N], shape (nv,)."""
        return self._force.blend(data, x, self._signs)
