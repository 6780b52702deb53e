"""Continuous sliding mode control of second order."""

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

_ROOT = 1.1128  # describing function of |s|^(1/2) sgn s at amplitude 1: 4/pi times a beta function


class SuperTwisting(Controller):
    """Drives s = e' + lambda e and s' to zero in finite time with a continuous command.

        tau = A^+ (a_ref - lambda e' - a_free - k1 |s|^(1/2) sgn s + w)
        w' = -k2 P sgn s,   k1 = c1 L^(1/2),   k2 = c2 L

    componentwise: the mobility A of the constrained model decouples the joints. P projects onto
    the accelerations that efforts can give, the identity unless actuation is redundant. w is the
    memory; it learns the disturbance. It stands still where it would push further against the
    effort box (anti-windup).

    Args:
        bandwidth: lambda: errors decay by exp(-lambda t) on s = 0.
        disturbance_rate: L: must exceed the rate of change of the accelerations that model error
            and disturbance cause.
        proportional: c1, factor of k1.
        integral: c2, factor of k2, > 1; with c2 > 1 + 2 / c1^2 the reaching time is provable, by
            default down to an effectiveness of 0.7 (masses wrong by 30 %).

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
        """No disturbance known: w = 0 [rad/s^2 or m/s^2], shape (n,)."""
        return np.zeros(len(self.joints))

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """The control at a state."""
        r = self.joints.response(x)
        s, a_keep = sliding_variable(r, ref, self._bandwidth)
        push, rate = super_twisting(s, self._k1, self._k2)
        mobility = MobilityFactor(r.mobility)
        equivalent = mobility.solve(a_keep - r.a_free)
        effort = equivalent + mobility.solve(push + memory)
        clipped = np.minimum(np.maximum(effort, box.lower), box.upper)
        denied = r.mobility.dot(effort - clipped)
        rate = np.where(denied * rate > 0.0, 0.0, mobility.reachable(rate))
        return Control(effort, s, equivalent, rate, np.zeros(0, dtype=np.bool_))

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """Describing functions of both parts at |s| = `_width`.

        A delay makes s swing, by |s| ~ delay^2; up to the tolerable delay it swings less.
        """
        push = _ROOT * self._k1 / np.sqrt(self._width)
        integral = 4.0 / np.pi * self._k2 / self._width
        return sliding_gains(self._bandwidth, push, integral)

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """|s| / lambda, with the s that a disturbance of the rate L causes within 1 / lambda."""
        return self._width / self._bandwidth

    def reaching_time(self, s: Array, excess: Array, effectiveness: float = 1.0) -> float:
        """A time within which s becomes zero for good, if `disturbance_rate` is a bound.

        Moreno's and Osorio's bound for s / L, whose gains g c1 and g c2 have no unit: their
        Lyapunov function is not invariant to units, and weak far from L = 1.

        Args:
            s: At the start [rad/s or m/s], shape (n,).
            excess: d + g w at the start [rad/s^2 or m/s^2], shape (n,).
            effectiveness: g of s' = d - g (k1 |s|^(1/2) sgn s - w), see `Mismatch`.

        Returns:
            [s]; inf where the Lyapunov function of `reaching_time_bound` proves nothing.
        """
        k1, k2, L = effectiveness * self._c1, effectiveness * self._c2, self._limit
        return float(reaching_time_bound(k1, k2, s / L, excess / L, 1.0).max())
