"""Reaching laws of sliding mode control: how fast s is driven to zero."""

from typing import Literal, get_args

import numpy as np

from mbd_ros.core.control.contract import per_joint
from mbd_ros.core.ranges import Gain
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

ReachingName = Literal["constant", "exponential", "power_rate"]
LAWS: tuple[ReachingName, ...] = get_args(ReachingName)
_SAMPLED = 1.3  # for masses wrong by 30 %
_NO_LAYER = 1.0e-300  # a layer without effect: s / _NO_LAYER neither overflows nor divides zeros


class ReachingLaw:
    """The rho of s' = -rho(s), each joint for itself.

        constant     rho = k sgn s
        exponential  rho = k sgn s + c s
        power_rate   rho = k |s|^p sgn s,  0 < p < 1

    Within a boundary layer |s| < phi the straight line from 0 to rho(phi) takes their place, so
    that rho is continuous; phi = 0 leaves it as it is. In a loop of period h, phi >= k h keeps
    the constant law from overshooting; phi = k h makes its explicit steps those of the implicit
    Euler method for the discontinuous law, which ends in s = 0 without chatter.

    Args:
        n: Number of joints.
        law: One of `LAWS`.
        gain: k [rad/s^2 or m/s^2; power_rate: per (rad/s)^p], > 0, one or one a joint.
        rate: c [1/s], > 0, one or one a joint; read by exponential only.
        power: p; read by power_rate only.
        boundary_layer: phi [rad/s or m/s], >= 0, one or one a joint.

    Raises:
        ModelError: Names the gain, and what is accepted.

    Source: W. Gao, J. C. Hung, IEEE Trans. Ind. Electron. 40, 1993, 45-55 (the laws); J.-J. E.
        Slotine, S. S. Sastry, Int. J. Control 38, 1983, 465-492 (boundary layer); V. Acary,
        B. Brogliato, Syst. Control Lett. 59, 2010, 284-293 (implicit Euler method).
    """

    def __init__(
        self, n: int, law: ReachingName, gain: Gain, rate: Gain, power: float, boundary_layer: Gain
    ) -> None:
        if law not in LAWS:
            raise ModelError(f"law '{law}', accepted: {', '.join(LAWS)}")
        if not 0.0 < power < 1.0:
            raise ModelError(f"power {power:g} must be > 0 and < 1")
        self._gain = per_joint(gain, n, "gain")
        layer = per_joint(boundary_layer, n, "boundary_layer", least=0.0)
        self._layer = np.maximum(layer, _NO_LAYER)
        self._is_exponential = law == "exponential"
        self._rate = per_joint(rate, n, "rate") if self._is_exponential else np.zeros(n)
        self._power = power if law == "power_rate" else 0.0

    def __call__(self, s: Array) -> Array:
        """Value rho(s) [rad/s^2 or m/s^2], shape (n,)."""
        size = np.maximum(np.abs(s), self._layer)
        rho = self._gain * (s / size)
        if self._power:
            rho *= size**self._power
        elif self._is_exponential:
            rho += self._rate * s
        return rho

    def layer(self, period: float) -> Array:
        """Boundary layer [rad/s or m/s], shape (n,); without one what a period makes of it.

        A step of the reaching law leads there: s = 1.3 h k s^p.
        """
        sampled = (_SAMPLED * period * self._gain) ** (1.0 / (1.0 - self._power))
        return np.where(self._layer > _NO_LAYER, self._layer, sampled)

    def slope(self, period: float) -> Array:
        """Of rho within that layer [1/s], shape (n,)."""
        layer = self.layer(period)
        return self._gain * layer ** (self._power - 1.0) + self._rate

    def width(self, disturbance: Array | float, effectiveness: Array | float = 1.0) -> Array:
        """Where |s| settles under s' = d - g rho(s): rho(width) = disturbance / effectiveness.

        Args:
            disturbance: Bound of |d| [rad/s^2 or m/s^2].
            effectiveness: Least g, > 0.

        Returns:
            [rad/s or m/s], shape (n,); inf where the law cannot withstand the disturbance.
        """
        demand = np.broadcast_to(np.divide(disturbance, effectiveness), self._gain.shape)
        edge = self._gain * self._layer**self._power + self._rate * self._layer
        inside: Array = self._layer * demand / edge
        with np.errstate(divide="ignore"):
            if self._power:
                outside = (demand / self._gain) ** (1.0 / self._power)
            elif self._is_exponential:
                outside = (demand - self._gain) / self._rate
            else:
                outside = np.full_like(demand, np.inf)
        return np.where(demand <= edge, inside, outside)
