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
    """Makes the errors of a true model those of a damped oscillator: e'' + kd e' + kp e = 0.

        tau = A^+ (a_ref - kd e' - kp e - a_free)

    Only kp withstands disturbances: they leave e = d / kp. With lambda = kp / kd in
    s = e' + lambda e the control law is s' = lambda e' - kd s.

    Args:
        kp: Acceleration per error.
        kd: Acceleration per velocity error; 2 kp^(1/2) damps critically.

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
        """Its own gains."""
        return pd_gains(self._kd * self._bandwidth, self._kd)

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Acceleration that wrong masses cause, over kp."""
        return disturbance(at_rest.a_free) / (self._kd * self._bandwidth)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """The control at a state."""
        r = self.joints.response(x)
        s, a_keep = sliding_variable(r, ref, self._bandwidth)
        mobility = MobilityFactor(r.mobility)
        equivalent = mobility.solve(a_keep - r.a_free)
        effort = mobility.solve(ref.a - self._kd * s - r.a_free)
        return Control(effort, s, equivalent, np.zeros(0), np.zeros(0, dtype=np.bool_))
