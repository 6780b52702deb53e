"""Tracking by a quadratic program that respects the limits of drives and joints."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.hard_soft_qp import Candidate, Counts, HardSoftQp
from mbd_ros.core.ranges import Gain, Unit, Within
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
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
from mbd_ros.methods.control.efforts import AccelerationBox, MotionLimits, TrackingMetric
from mbd_ros.methods.control.sliding_mode import sliding_variable


class QpTracking(Controller):
    """Tracking control by a constrained quadratic program.

        min |a - a_ref|²_W   subject to   a_all = a_free + mobility tau,  tau in the effort box,
                                          lower <= a_all <= upper  (`MotionLimits`)
        a_ref = ref.a - kd e' - kp e,     e = q - ref.q

    a_all are the accelerations of all joints under the constraints, so limits of dependent joints
    are respected too. While no limit is active, the effort is that of computed torque and no QP
    is solved. Effort limits are hard. Where they make the limits of motion infeasible, the sum of
    squares of the violations is minimised. Redundant efforts have minimum norm. Contacts are left
    out, and so is the change of torque that rate limits allow in later periods; a longer horizon
    compensates for that.

    Source: A. Escande, N. Mansard, P. Wieber, Int. J. Robotics Research 33(7) (2014), on the
    hierarchy of hard limits, soft limits and the task.

    Args:
        kp: Acceleration per position error, > 0.
        kd: Acceleration per velocity error, > 0; 2 kp^(1/2) is critical damping.
        weight: Cost of a squared acceleration error, > 0.
        horizon: Prediction time in which limits of motion are respected; at least the period of
            the commands, longer for drives that need longer to reverse their torque.
        braking: Time in which a joint can brake from its largest velocity to rest.
        position_margin: Distance to keep from position limits.
        position_limits: Whether position limits of the robot description are respected.
        velocity_limits: Whether velocity limits of the robot description are respected.

    Attributes:
        counts: Statistics of the QPs solved so far.

    Raises:
        ModelError: A value that is not accepted, or proxsuite is not installed.
    """

    example = {"kp": 100.0, "kd": 20.0, "weight": 1.0, "horizon": 0.02, "braking": 0.2}

    def __init__(
        self,
        joints: ControlledJoints,
        *,
        kp: Annotated[Gain, Unit("1/s^2")] = 100.0,
        kd: Annotated[Gain, Unit("1/s")] = 20.0,
        weight: Annotated[Gain, Unit("s^4/rad^2 or s^4/m^2")] = 1.0,
        horizon: Annotated[float, Within(1.0e-6, 10.0), Unit("s")] = 0.02,
        braking: Annotated[float, Within(1.0e-6, 10.0), Unit("s")] = 0.2,
        position_margin: Annotated[float, Within(0.0, 10.0), Unit("rad or m")] = 0.0,
        position_limits: bool = True,
        velocity_limits: bool = True,
    ) -> None:
        n = len(joints)
        self.joints = joints
        self._kd = per_joint(kd, n, "kd")
        self._weight = per_joint(weight, n, "weight")
        self._bandwidth = per_joint(kp, n, "kp") / self._kd
        self._limits = MotionLimits(
            joints.system.robot.joints,
            horizon=horizon,
            braking=braking,
            margin=position_margin,
            position=position_limits,
            velocity=velocity_limits,
        )
        limited = self._limits.joints
        self._rows = np.array([joint.v for joint in limited], dtype=np.intp)
        self._has_velocity = self._limits.has_velocity.nonzero()[0]
        self._has_position = self._limits.has_position.nonzero()[0]
        self.limit_names = (
            *(f"torque {name}" for name in joints.names),
            *(f"velocity {limited[i].name}" for i in self._has_velocity),
            *(f"position {limited[i].name}" for i in self._has_position),
        )
        self._none_active = np.zeros(len(self.limit_names), dtype=np.bool_)
        self._none_active.flags.writeable = False
        self._qp = HardSoftQp(n, len(limited))

    @property
    def counts(self) -> Counts:
        """Statistics of the QPs; `solves` does not count states at which no limit was active."""
        return self._qp.counts

    def details(self) -> dict[str, str]:
        """Return the statistics of the QPs."""
        return {f"qp {name}": str(count) for name, count in self.counts._asdict().items()}

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """Return kp and kd, as for computed torque: active limits do not make the loop faster."""
        return pd_gains(self._kd * self._bandwidth, self._kd)

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Return the acceleration error of wrong masses, divided by kp."""
        return disturbance(at_rest.a_free) / (self._kd * self._bandwidth)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """Return the control at a state.

        Raises:
            SolveError: State, reference or dynamics are not finite, or the effort box is empty.
        """
        a_free, mobility = self.joints.accelerations(x)
        r = self.joints.response(x, (a_free, mobility))
        s, a_steady = sliding_variable(r, ref, self._bandwidth)
        a_ref = np.stack([ref.a - self._kd * s, a_steady], axis=1)
        _check(r, a_ref, box)
        metric = TrackingMetric(r.mobility, self._weight)
        tau, equivalent = metric.efforts(a_ref - r.a_free[:, None]).T
        rows, motion = mobility[self._rows], self._limits.box(x)
        a = a_free[self._rows] + rows.dot(tau)
        excess = np.maximum(box.lower - tau, tau - box.upper).max()
        if excess <= 0.0 and (motion.lower <= a).all() and (a <= motion.upper).all():
            return Control(tau, s, equivalent, memory[:0], self._none_active)
        tau, active = self._limited(metric, tau, rows, a, box, motion)
        return Control(tau, s, equivalent, memory[:0], active)

    def _limited(
        self,
        metric: TrackingMetric,
        tau: Array,
        rows: Array,
        a: Array,
        box: EffortBox,
        motion: AccelerationBox,
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the effort within limits and the active limits.

        Args:
            metric: Metric of tracking errors.
            tau: Effort without limits.
            rows: Rows of the mobility of the joints with limits.
            a: Accelerations of these joints under `tau`.
            box: Effort limits.
            motion: Acceleration limits of these joints.
        """
        T = metric.directions()
        lower = np.concatenate([box.lower - tau, motion.lower - a])
        upper = np.concatenate([box.upper - tau, motion.upper - a])
        try:
            solution = self._qp.solve(np.concatenate([T, rows.dot(T)]), lower, upper)
        except SolveError:  # `counts` has it; a clipped command is better than none
            clipped = np.clip(tau, box.lower, box.upper)
            n = len(self._none_active) - len(tau)
            return clipped, np.concatenate([clipped != tau, np.zeros(n, dtype=np.bool_)])
        n = len(tau)
        active_side = solution.side[:n]
        effort = np.clip(tau + T.dot(solution.y), box.lower, box.upper)
        effort = np.where(active_side > 0, box.lower, np.where(active_side < 0, box.upper, effort))
        return effort, self._active_limits(solution, motion)

    def _active_limits(self, solution: Candidate, motion: AccelerationBox) -> NDArray[np.bool_]:
        """Return which of `limit_names` are active."""
        n = len(self.joints)
        side = solution.side[n:]
        at_position = np.where(side > 0, motion.position_below, motion.position_above)
        at_position &= side != 0
        at_velocity = (side != 0) & ~at_position
        return np.concatenate(
            [
                solution.side[:n] != 0,
                at_velocity[self._has_velocity],
                at_position[self._has_position],
            ]
        )


def _check(r: Response, a_ref: Array, box: EffortBox) -> None:
    values = (r.q, r.v, r.a_free, r.mobility, a_ref)
    if not all(np.isfinite(value).all() for value in values):
        raise SolveError("state, reference or dynamics are not finite")
    if not ((box.lower <= box.upper) & (box.lower < np.inf) & (box.upper > -np.inf)).all():
        raise SolveError("effort limits are not a number, or a lower one is above its upper one")
