"""Linear feedback along a plan, with gains that change on the way."""

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
    """Follows the motion of a plan by the gains of its linear quadratic regulator.

        tau = tau_plan(t) - K(t) e,   e = [q - q_plan(t); v - v_plan(t)]

    e is that of all independent joints, actuated or not, so that a mechanism with fewer drives
    than freedoms can be led too. The plan begins when this law takes over alone, and stands still
    while nobody hears the commands; at its end it is held. References of topics do not count.

    Args:
        plan: File that `mbd-ros follow` has written.

    Raises:
        ModelError: There is no plan, or it is one of other joints.
    """

    example = {}
    files = ("plan",)

    def __init__(self, joints: ControlledJoints, *, plan: TrackingPlan | str = "") -> None:
        if not isinstance(plan, TrackingPlan):
            raise ModelError("plan is missing, accepted: a file that `mbd-ros follow` has written")
        robot = joints.system.robot
        unknown = [n for n in plan.joints if n not in {j.name for j in robot.joints}]
        if unknown or sorted(plan.inputs) != sorted(joints.names):
            raise ModelError(
                f"plan: its joints {', '.join(plan.joints)} and inputs {', '.join(plan.inputs)} "
                f"are not those of the scene, whose inputs are {', '.join(joints.names)}"
            )
        self.joints = joints
        self.plan = plan
        at = [robot.joint(name) for name in plan.joints]
        self._q, self._v = (np.array([getattr(j, f) for j in at], dtype=np.intp) for f in "qv")
        self._order = [plan.inputs.index(name) for name in joints.names]
        self._newest = (plan.begin, 0.0)

    def begin(self) -> Array:
        """Time of the plan [s], at its begin, shape (1,)."""
        return np.array([self.plan.begin])

    @property
    def share(self) -> float:
        """Newest cost to go over that of the tube; 0 where the plan states no tube."""
        return self._newest[1] / self.plan.level if self.plan.level > 0.0 else 0.0

    def warnings(self) -> tuple[str, ...]:
        """Says when the motion is outside of the tube."""
        if self.share <= 1.0:
            return ()
        return (f"outside of the tube of the plan: {self.share:.3g} of its level",)

    def details(self) -> dict[str, str]:
        """Where on the plan it is, and how far from it."""
        tube = f"{self.share:.3g} of its level" if self.plan.level > 0.0 else "none stated"
        t, end = self._newest[0], self.plan.end
        return {"time of the plan": f"{t:.6g} of {end:.6g} s", "tube of the plan": tube}

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """The control at a state."""
        t = float(memory[0])
        r, wanted = self.joints.response(x), self.plan.at(t)
        e = np.concatenate([x.q[self._q] - wanted.q, x.v[self._v] - wanted.v])
        self._newest = (min(t, self.plan.end), float(e.dot(wanted.cost).dot(e)))
        planned = wanted.u[self._order]
        effort = planned - wanted.gain.dot(e)[self._order]
        rate = np.array([1.0 if t < self.plan.end else 0.0])
        return Control(effort, r.v - ref.v, planned, rate, _NONE)
