"""Second-order sliding mode control with a continuous command."""

from typing import Annotated

import numpy as np

from mbd_ros.core.ranges import Gain, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.methods.control.contract import (
    Control,
    ControlledJoints,
    Controller,
    EffortBox,
    LoopGains,
    Reference,
    Response,
    per_joint,
    sliding_gains,
)
from mbd_ros.methods.control.efforts import MobilityFactor
from mbd_ros.methods.control.sliding_mode import (
    reaching_time_bound,
    sliding_variable,
    super_twisting,
)

_DESCRIBING = 1.1128  # describing function of |s|^(1/2) sgn s at amplitude 1


class SuperTwisting(Controller):
    """Super-twisting control: drives s = e' + lambda e and s' to zero in finite time.

        tau = A^+ (a_ref - lambda e' - a_free - k1 |s|^(1/2) sgn s + w)
        w' = -k2 P sgn s,   k1 = c1 L^(1/2),   k2 = c2 L

    The equations hold per joint, since the mobility A decouples the joints. P projects onto the
    accelerations that efforts can produce; it is the identity unless actuation is redundant. The
    memory w converges to the negative disturbance. It is frozen where it would push further
    against an effort limit (anti-windup).

    Args:
        bandwidth: lambda; on s = 0 errors decay as exp(-lambda t).
        disturbance_rate: L, which must exceed the rate of change of the accelerations due to model
            errors and disturbances.
        proportional: c1, factor of k1.
        integral: c2 > 1, factor of k2. If c2 > 1 + 2 / c1^2, a bound on the reaching time exists;
            with the default values it does down to an effectiveness of 0.7 (masses 30 % off).

    Source: A. Levant, Int. J. Control 58, 1993, 1247-1263; J. A. Moreno, M. Osorio, IEEE Trans.
        Autom. Control 57, 2012, 1035-1040; I. Boiko, L. Fridman, IEEE Trans. Autom. Control 50,
        2005, 1442-1446 (describing functions).
    """

    example = {"bandwidth": 20.0, "disturbance_rate": 500.0}

    def __init__(
        self,
        joints: ControlledJoints,
        *,
        bandwidth: Annotated[Gain, Unit("1/s")] = 20.0,
        disturbance_rate: Annotated[Gain, Unit("rad/s^3 or m/s^3")] = 200.0,
        proportional: Annotated[Gain, Unit("-")] = 3.0,
        integral: Annotated[Gain, Unit("-")] = 2.5,
    ) -> None:
        n = len(joints)
        self.joints = joints
        self._bandwidth = per_joint(bandwidth, n, "bandwidth")
        self._limit = per_joint(disturbance_rate, n, "disturbance_rate")
        self._c1 = per_joint(proportional, n, "proportional")
        self._c2 = per_joint(integral, n, "integral", above=1.0)
        self._width = self._limit / self._bandwidth**2
        self._k1 = self._c1 * np.sqrt(self._limit)
        self._k2 = self._c2 * self._limit

    def begin(self) -> Array:
        """Return w = 0, since no disturbance is known [rad/s^2 or m/s^2], shape (n,)."""
        return np.zeros(len(self.joints))

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """Return the control at a state."""
        r = self.joints.response(x)
        s, a_steady = sliding_variable(r, ref, self._bandwidth)
        feedback, rate = super_twisting(s, self._k1, self._k2)
        mobility = MobilityFactor(r.mobility)
        equivalent = mobility.solve(a_steady - r.a_free)
        effort = equivalent + mobility.solve(feedback + memory)
        clipped = np.minimum(np.maximum(effort, box.lower), box.upper)
        excess = r.mobility.dot(effort - clipped)  # acceleration beyond the effort limits
        rate = np.where(excess * rate > 0.0, 0.0, mobility.reachable(rate))
        return Control(effort, s, equivalent, rate, np.zeros(0, dtype=np.bool_))

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """Return the describing functions of both terms at the amplitude `_width` of s.

        A delay makes s oscillate with |s| ~ delay^2; up to the tolerable delay it stays below that
        amplitude.
        """
        proportional = _DESCRIBING * self._k1 / np.sqrt(self._width)
        integral = 4.0 / np.pi * self._k2 / self._width
        return sliding_gains(self._bandwidth, proportional, integral)

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Return |s| / lambda for the s that a disturbance of rate L causes within 1 / lambda."""
        return self._width / self._bandwidth

    def reaching_time(self, s: Array, excess: Array, effectiveness: float = 1.0) -> float:
        """Return a bound on the reaching time of s = 0, provided that `disturbance_rate` holds.

        This is the bound of Moreno and Osorio for s / L, whose gains g c1 and g c2 have no unit;
        their Lyapunov function depends on units, and its bound is weak far from L = 1.

        Args:
            s: Initial sliding variable [rad/s or m/s], shape (n,).
            excess: Initial d + g w [rad/s^2 or m/s^2], shape (n,).
            effectiveness: g in s' = d - g (k1 |s|^(1/2) sgn s - w), see `Mismatch`.

        Returns:
            Reaching time [s]; inf where the Lyapunov function proves nothing.
        """
        k1, k2, L = effectiveness * self._c1, effectiveness * self._c2, self._limit
        return float(reaching_time_bound(k1, k2, s / L, excess / L, 1.0).max())
