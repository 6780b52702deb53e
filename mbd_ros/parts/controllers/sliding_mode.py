"""Sliding mode control with a boundary layer."""

from typing import Annotated

import numpy as np

from mbd_ros.core.ranges import Gain, Unit, Within
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
from mbd_ros.methods.control.sliding_mode import ReachingLaw, ReachingName, sliding_variable


class SlidingMode(Controller):
    """Sliding mode control: drives s = e' + lambda e of every joint to zero despite disturbances.

        tau = A^+ (a_ref - lambda e' - a_free) - A^+ rho(s)

    The first term is the equivalent control; with an exact model s' = -rho(s). A^+ is the
    pseudo-inverse of the mobility A, and A and a_free include couplings and loops. The reaching
    law rho is k sgn s (constant), k sgn s + c s (exponential) or k |s|^p sgn s (power rate); in
    the boundary layer |s| < phi it is replaced by the line from 0 to rho(phi).

    Args:
        bandwidth: lambda; on s = 0 errors decay as exp(-lambda t).
        gain: k, which must exceed the accelerations due to model errors and disturbances.
        boundary_layer: phi >= 0, half the width of the layer in which the command is continuous;
            at least `gain` times the control period avoids chattering.
        law: Reaching law rho.
        rate: c of the exponential reaching law.
        power: Exponent p of the power-rate reaching law, > 0 and < 1.

    Source: V. Utkin, IEEE Trans. Autom. Control 22, 1977, 212-222; J.-J. E. Slotine, W. Li,
        Applied Nonlinear Control, 1991, sec. 7.2.
    """

    example = {"bandwidth": 20.0, "gain": 60.0, "boundary_layer": 0.1}

    def __init__(
        self,
        joints: ControlledJoints,
        *,
        bandwidth: Annotated[Gain, Unit("1/s")] = 20.0,
        gain: Annotated[Gain, Unit("rad/s^2 or m/s^2")] = 60.0,
        boundary_layer: Annotated[Gain, Unit("rad/s or m/s")] = 0.5,
        law: ReachingName = "constant",
        rate: Annotated[Gain, Unit("1/s")] = 10.0,
        power: Annotated[float, Within(1.0e-6, 0.999999), Unit("-")] = 0.5,
    ) -> None:
        self.joints = joints
        self._bandwidth = per_joint(bandwidth, len(joints), "bandwidth")
        self._law = ReachingLaw(len(joints), law, gain, rate, power, boundary_layer)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """Return the control at a state."""
        r = self.joints.response(x)
        s, a_steady = sliding_variable(r, ref, self._bandwidth)
        mobility = MobilityFactor(r.mobility)
        equivalent = mobility.solve(a_steady - r.a_free)
        effort = equivalent - mobility.solve(self._law(s))
        return Control(effort, s, equivalent, np.zeros(0), np.zeros(0, dtype=np.bool_))

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """Return gains from the slope of the reaching law in its boundary layer."""
        return sliding_gains(self._bandwidth, self._law.slope(period))

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Return the edge of the boundary layer over lambda."""
        return self._law.layer(period) / self._bandwidth

    def bound(self, disturbance: Array | float, effectiveness: Array | float = 1.0) -> Array:
        """Return a bound on the position errors once s has settled.

        Args:
            disturbance: Bound on `Mismatch.disturbance` near the reference [rad/s^2 or m/s^2],
                for all joints or for each.
            effectiveness: Lower bound on `Mismatch.effectiveness` E; if E is not diagonal and all
                joints have the same gains, the least E_ii minus the sum of |E_ij| over j.

        Returns:
            Bound [rad or m], shape (n,); inf where the gain is too small.
        """
        return self._law.width(disturbance, effectiveness) / self._bandwidth
