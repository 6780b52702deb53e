"""Time-varying linear feedback along a planned trajectory."""

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError
from mbd_ros.methods.control.contract import (
    Control,
    ControlledJoints,
    Controller,
    EffortBox,
    Reference,
)
from mbd_ros.methods.control.tracking_plan import TrackingPlan

_NONE = np.zeros(0, dtype=np.bool_)


class TrajectoryTracking(Controller):
    """Linear quadratic regulator about the trajectory of a plan.

        tau = tau_plan(t) - K(t) e,   e = [q - q_plan(t); v - v_plan(t)]

    e contains all independent joints, actuated or not, so underactuated mechanisms can be
    controlled too. Time in the plan starts when this control law takes over, and stops while no
    commands are received; after the end of the plan its last point is held. References from
    topics are ignored.

    Args:
        plan: File that `mbd-ros follow` has written.

    Raises:
        ModelError: The plan is missing, or belongs to other joints.
    """

    example = {}
    files = ("plan",)

    def __init__(self, joints: ControlledJoints, *, plan: TrackingPlan | str = "") -> None:
        if not isinstance(plan, TrackingPlan):
            raise ModelError("plan is missing; give a file that `mbd-ros follow` has written")
        robot = joints.system.robot
        unknown = [n for n in plan.joints if n not in {j.name for j in robot.joints}]
        if unknown or sorted(plan.inputs) != sorted(joints.names):
            raise ModelError(
                f"plan: its joints {', '.join(plan.joints)} and inputs {', '.join(plan.inputs)} "
                f"are not those of the scene, whose inputs are {', '.join(joints.names)}"
            )
        self.joints = joints
        self.plan = plan
        plan_joints = [robot.joint(name) for name in plan.joints]
        self._q = np.array([joint.q for joint in plan_joints], dtype=np.intp)
        self._v = np.array([joint.v for joint in plan_joints], dtype=np.intp)
        self._order = [plan.inputs.index(name) for name in joints.names]
        self._newest = (plan.begin, 0.0)  # time in the plan, cost to go

    def begin(self) -> Array:
        """Return the start time of the plan [s], shape (1,)."""
        return np.array([self.plan.begin])

    @property
    def share(self) -> float:
        """Newest cost to go relative to that of the tube; 0 for a plan without a tube."""
        return self._newest[1] / self.plan.level if self.plan.level > 0.0 else 0.0

    def warnings(self) -> tuple[str, ...]:
        """Return a warning if the motion is outside of the tube."""
        if self.share <= 1.0:
            return ()
        return (f"outside of the tube of the plan: {self.share:.3g} of its level",)

    def details(self) -> dict[str, str]:
        """Return the time in the plan and the distance from it, for diagnostics."""
        tube = f"{self.share:.3g} of its level" if self.plan.level > 0.0 else "none stated"
        t, end = self._newest[0], self.plan.end
        return {"time of the plan": f"{t:.6g} of {end:.6g} s", "tube of the plan": tube}

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """Return the control at a state."""
        t = float(memory[0])
        r, point = self.joints.response(x), self.plan.at(t)
        e = np.concatenate([x.q[self._q] - point.q, x.v[self._v] - point.v])
        self._newest = (min(t, self.plan.end), float(e.dot(point.cost).dot(e)))
        planned = point.u[self._order]
        effort = planned - point.gain.dot(e)[self._order]
        rate = np.array([1.0 if t < self.plan.end else 0.0])
        return Control(effort, r.v - ref.v, planned, rate, _NONE)
