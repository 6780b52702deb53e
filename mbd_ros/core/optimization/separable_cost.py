"""Costs that are a sum of convex functions of one unknown each.

f_i(x) = linear_i x + weight_i |x|^p + stiffness_i (x - target_i)^2,   p >= 1
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY

Indices = NDArray[np.intp]


class SeparableCost(NamedTuple):
    """The f above; one entry an unknown.

    Attributes:
        exponent: The p.
        weight: Shape (n,), >= 0.
        linear: Shape (n,).
        stiffness: Shape (n,), >= 0.
        target: Shape (n,).
    """

    exponent: float
    weight: Array
    linear: Array
    stiffness: Array
    target: Array

    @property
    def is_quadratic(self) -> bool:
        """Whether slopes are straight lines."""
        return self.exponent == 2.0

    def value(self, x: Array) -> float:
        """The sum of all f_i."""
        power = self.weight * np.abs(x) ** self.exponent
        return float((self.linear * x + power + self.stiffness * (x - self.target) ** 2).sum())

    def slope(self, x: Array) -> Array:
        """The f_i', shape (n,); the middle of all slopes where f_i has a kink."""
        tracking = self.linear + 2.0 * self.stiffness * (x - self.target)
        if self.is_quadratic:
            return tracking + 2.0 * self.weight * x
        p = self.exponent
        return tracking + p * self.weight * np.sign(x) * np.abs(x) ** (p - 1.0)

    def curvature(self, x: Array) -> Array:
        """The f_i'', shape (n,); huge but finite at 0 where p < 2."""
        if self.is_quadratic:
            return 2.0 * (self.stiffness + self.weight)
        p = self.exponent
        size = np.maximum(np.abs(x), TINY ** (1.0 / max(p, 2.0)))
        return 2.0 * self.stiffness + p * (p - 1.0) * self.weight * size ** (p - 2.0)

    def kink(self, x: Array) -> Array:
        """Half the jump of f_i' at x, shape (n,): weight_i at 0 where p = 1, else 0."""
        return np.where((x == 0.0) & (self.exponent == 1.0), self.weight, 0.0)

    def inverse_slope(self) -> Callable[[Array], Array]:
        """The `at_slope` of many slopes."""
        if not self.is_quadratic:
            return self.at_slope
        at_zero = self.linear - 2.0 * self.stiffness * self.target
        curvature = np.maximum(2.0 * (self.stiffness + self.weight), TINY)
        return lambda slope: (slope - at_zero) / curvature

    def at_slope(self, slope: Array) -> Array:
        """The x with f_i' = slope where p > 1, tracking left aside but for p = 2, shape (n,)."""
        if self.is_quadratic:
            return self.inverse_slope()(slope)
        rest = (slope - self.linear) / (self.exponent * np.maximum(self.weight, TINY))
        return np.sign(rest) * np.abs(rest) ** (1.0 / (self.exponent - 1.0))

    def some(self, which: Indices, sign: float = 1.0) -> "SeparableCost":
        """Of some unknowns, or of their negatives, as functions of them."""
        linear, target = sign * self.linear[which], sign * self.target[which]
        return SeparableCost(
            self.exponent, self.weight[which], linear, self.stiffness[which], target
        )

    def joined(self, other: "SeparableCost") -> "SeparableCost":
        """Of these unknowns, then of others."""
        pairs = zip(self[1:], other[1:], strict=True)
        return SeparableCost(self.exponent, *(np.concatenate(pair) for pair in pairs))


def power_cost(exponent: float, weight: Array) -> SeparableCost:
    """The sum of weight_i |x_i|^p."""
    none = np.zeros(len(weight))
    return SeparableCost(float(exponent), weight, none, none, none)
