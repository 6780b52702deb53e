"""The motion on springs, dampers and bristles: symmetric, and nothing in it grows by itself.

    y'' = -K y - C y' - T' k z,   z' = T y'

All bristles together are springs of the stiffness T' k T, as z - T y stays what it is.
"""

from functools import cached_property

import numpy as np

from mbd_ros.core.integration.linear_motion import LinearMotion
from mbd_ros.core.state import Array


class SpringMotion(LinearMotion):
    """Motion on springs, dampers and bristles; their deflections stand beside velocities.

    Args:
        springs: The K [1/s^2], symmetric, shape (n, n).
        dampers: The C [1/s], symmetric, shape (n, n).
        tips: The T, shape (m, n).
        bends: The k of each bristle [N/m], shape (m,).

    Attributes:
        springs: As given.
        dampers: As given.
        bristles: Their T' k T [1/s^2], shape (n, n).
    """

    def __init__(self, springs: Array, dampers: Array, tips: Array, bends: Array) -> None:
        r, n = len(springs), len(springs) + len(tips)
        stiffness, damping = np.zeros((2, n, n))
        stiffness[:r, :r], damping[:r, :r] = -springs, -dampers
        damping[:r, r:], damping[r:, :r] = -(tips.T * bends), tips
        super().__init__(stiffness, damping)
        self.springs, self.dampers, self.bristles = springs, dampers, (tips.T * bends).dot(tips)

    @cached_property
    def eigenvalues(self) -> Array:
        """Complex rates of the motion [1/s], those apart which are 0; inf where it has none."""
        stiffness = self.springs + self.bristles
        if not self.dampers.any() and np.isfinite(stiffness).all():
            squares = np.maximum(np.linalg.eigvalsh(stiffness), 0.0)
            rates: Array = np.emath.sqrt(-squares)
            return rates
        return LinearMotion(-stiffness, -self.dampers).eigenvalues

    def growth(self, dt: float) -> float:
        """Largest factor by which the motion itself grows in dt [s], which is 1."""
        return 1.0
