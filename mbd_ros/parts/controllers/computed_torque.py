"""Computed torque control."""

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
    disturbance,
    pd_gains,
    per_joint,
)
from mbd_ros.methods.control.efforts import MobilityFactor
from mbd_ros.methods.control.sliding_mode import sliding_variable


class ComputedTorque(Controller):
    """Computed torque control: with an exact model the errors obey e'' + kd e' + kp e = 0.

        tau = A^+ (a_ref - kd e' - kp e - a_free)

    A constant disturbance acceleration d causes the steady error e = d / kp. The reported sliding
    variable is s = e' + lambda e with lambda = kp / kd.

    Args:
        kp: Acceleration per position error.
        kd: Acceleration per velocity error; 2 kp^(1/2) is critical damping.

    Source: J. Y. S. Luh, M. W. Walker, R. P. C. Paul, IEEE Trans. Autom. Control 25, 1980,
        468-474.
    """

    example = {"kp": 100.0, "kd": 20.0}

    def __init__(
        self,
        joints: ControlledJoints,
        *,
        kp: Annotated[Gain, Unit("1/s^2")] = 400.0,
        kd: Annotated[Gain, Unit("1/s")] = 40.0,
    ) -> None:
        self.joints = joints
        self._kd = per_joint(kd, len(joints), "kd")
        self._bandwidth = per_joint(kp, len(joints), "kp") / self._kd

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """Return kp and kd."""
        return pd_gains(self._kd * self._bandwidth, self._kd)

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Return the acceleration error of wrong masses, divided by kp."""
        return disturbance(at_rest.a_free) / (self._kd * self._bandwidth)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """Return the control at a state."""
        r = self.joints.response(x)
        s, a_steady = sliding_variable(r, ref, self._bandwidth)
        mobility = MobilityFactor(r.mobility)
        equivalent = mobility.solve(a_steady - r.a_free)
        effort = mobility.solve(ref.a - self._kd * s - r.a_free)
        return Control(effort, s, equivalent, np.zeros(0), np.zeros(0, dtype=np.bool_))
