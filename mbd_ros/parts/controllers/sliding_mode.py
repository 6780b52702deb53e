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
    """Drives s = e' + lambda e to zero in spite of disturbances, each joint for itself.

        tau = A^+ (a_ref - lambda e' - a_free) - A^+ rho(s)

    The first term is the equivalent control of the constrained model, exact without errors: then
    s' = -rho(s). Couplings and loops stand in a_free and the mobility A, of which A^+ is the
    pseudo-inverse. The reaching law rho is k sgn s (constant), k sgn s + c s (exponential) or
    k |s|^p sgn s (power rate); for |s| < phi the line from 0 to rho(phi) takes its place.

    Args:
        bandwidth: lambda: errors decay by exp(-lambda t) on s = 0.
        gain: k: must exceed the accelerations that model error and disturbance cause.
        boundary_layer: phi, >= 0: width within which the command is continuous; at least `gain`
            times the period of the loop keeps it from chattering.
        law: Reaching law rho.
        rate: c of the exponential law.
        power: Exponent of the power-rate law, > 0 and < 1.

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
        """The control at a state."""
        r = self.joints.response(x)
        s, a_keep = sliding_variable(r, ref, self._bandwidth)
        mobility = MobilityFactor(r.mobility)
        equivalent = mobility.solve(a_keep - r.a_free)
        effort = equivalent - mobility.solve(self._law(s))
        return Control(effort, s, equivalent, np.zeros(0), np.zeros(0, dtype=np.bool_))

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """The slope of the reaching law within its boundary layer."""
        return sliding_gains(self._bandwidth, self._law.slope(period))

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """The edge of the boundary layer over lambda; the reaching law gives no more beyond."""
        return self._law.layer(period) / self._bandwidth

    def bound(self, disturbance: Array | float, effectiveness: Array | float = 1.0) -> Array:
        """Largest errors once s has settled: width of the reaching law over lambda.

        Args:
            disturbance: Bound of `Mismatch.disturbance` near the reference
                [rad/s^2 or m/s^2], one or one a joint.
            effectiveness: Least of `Mismatch.effectiveness`; where that is no diagonal matrix,
                and all joints have the same gains, its least E_ii less the sum of |E_ij|.

        Returns:
            [rad or m], shape (n,); inf where the gain is too small.
        """
        return self._law.width(disturbance, effectiveness) / self._bandwidth
