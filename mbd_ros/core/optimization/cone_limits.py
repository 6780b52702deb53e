"""Bounds and cones of friction that forces keep."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array


class Limits(NamedTuple):
    """What a vector may be: between bounds, and in cones |y_t| <= mu y_n.

    Attributes:
        lower: Lower ends, shape (n,).
        upper: Upper ends, shape (n,).
        cones: Where a normal and its two tangents stand in y, shape (k, 3).
        mu: Coefficient of friction of each, >= 0, shape (k,).
    """

    lower: Array
    upper: Array
    cones: NDArray[np.intp]
    mu: Array

    def excess(self, y: Array) -> Array:
        """By how much y passes each bound, then each cone, shape (n + k,)."""
        tangents = np.hypot(*y[self.cones[:, 1:]].T)
        beyond = tangents - self.mu * y[self.cones[:, 0]]
        return np.concatenate((np.maximum(self.lower - y, y - self.upper), beyond))

    def passed(self, y: Array, margin: float) -> NDArray[np.bool_]:
        """Which numbers pass their limits by more than a share of the largest, shape (n,)."""
        excess = self.excess(y) > margin * np.abs(y).max(initial=0.0)
        passed: NDArray[np.bool_] = excess[: len(y)]
        passed[self.cones[excess[len(y) :]].ravel()] = True
        return passed
