"""Joint springs and dampers about the reference, with gravity compensation."""

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
    pd_gains,
    per_joint,
)
from mbd_ros.methods.control.efforts import MobilityFactor
from mbd_ros.methods.control.sliding_mode import sliding_variable

_SLOWEST = 1.0e-6  # [1/s], damping rate of a mode that efforts cannot move


class GravityCompensation(Controller):
    """Gravity compensation with a compliant position feedback.

        tau = -A^+ a_free(q, v = 0) - stiffness e - damping e'

    The first term, reported as the equivalent control, balances gravity and all other forces at
    rest, subject to couplings and loops. The acceleration of the reference is not fed forward, so
    this control law is for holding and for slow motion. It is passive, and therefore stable for
    any positive gains, as long as the control loop is much faster than damping over inertia.

    Args:
        stiffness: Effort per position error.
        damping: Effort per velocity error; must be far less than inertia over control period.

    Source: M. Takegaki, S. Arimoto, J. Dyn. Syst. Meas. Control 103, 1981, 119-125.
    """

    example = {"stiffness": 1.0, "damping": 0.02}

    def __init__(
        self,
        joints: ControlledJoints,
        *,
        stiffness: Annotated[Gain, Unit("N·m/rad or N/m")] = 50.0,
        damping: Annotated[Gain, Unit("N·m·s/rad or N·s/m")] = 5.0,
    ) -> None:
        self.joints = joints
        self._damping = per_joint(damping, len(joints), "damping")
        self._bandwidth = per_joint(stiffness, len(joints), "stiffness") / self._damping

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """Return gains of the modes: eigenvalues of A D and the largest stiffness over damping."""
        root = np.sqrt(self._damping)
        rates = np.linalg.eigvalsh(root[:, None] * at_rest.mobility * root)
        damping = np.maximum(rates, _SLOWEST)
        return pd_gains(damping * self._bandwidth.max(), damping)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """Return the control at a state."""
        joints = self.joints
        r = joints.response(x._replace(v=np.zeros_like(x.v)))
        moving = r._replace(v=joints.velocities(x))
        s, _ = sliding_variable(moving, ref, self._bandwidth)
        equivalent = MobilityFactor(r.mobility).solve(-r.a_free)
        effort = equivalent - self._damping * s
        return Control(effort, s, equivalent, np.zeros(0), np.zeros(0, dtype=np.bool_))
