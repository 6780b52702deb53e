"""Accelerations as near to those of the reference as the limits of drives and joints allow."""

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
    """The constrained quadratic program of tracking.

        min |a - a_ref|²_W   subject to   a_all = a_free + mobility tau,  tau in the effort box,
                                          lower <= a_all <= upper  (`MotionLimits`)
        a_ref = ref.a - kd e' - kp e,     e = q - ref.q

    Couplings and loops are in a_all, so that dependent joints keep their limits too. As long as
    no limit is passed the effort is that of computed torque and no QP is solved. The effort box
    is always kept; where it leaves limits of motion out of reach, these are passed by the least
    sum of squares. Redundant efforts have the least norm. It leaves out contacts, and the jerk
    that torque-rate limits allow in later periods (a longer horizon makes up for it).
    Source: A. Escande, N. Mansard, P. Wieber, Int. J. Robotics Research 33(7) (2014), on the
    order of hard limits, softer ones and the task.

    Args:
        kp: Acceleration per error, > 0.
        kd: Acceleration per velocity error, > 0; 2 kp^(1/2) damps critically.
        weight: Cost of a squared acceleration error, > 0.
        horizon: Time ahead for which limits of motion are kept; at least the period of the
            commands, longer for drives that need longer to turn their torque round.
        braking: Time in which a joint can be brought from its largest velocity to rest.
        position_margin: Distance to keep from position limits.
        position_limits: Whether position limits of the robot description are kept.
        velocity_limits: Whether velocity limits of the robot description are kept.

    Attributes:
        counts: How the QPs went so far.

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
        self._slope = per_joint(kp, n, "kp") / self._kd
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
        self._idle = np.zeros(len(self.limit_names), dtype=np.bool_)
        self._idle.flags.writeable = False
        self._qp = HardSoftQp(n, len(limited))

    @property
    def counts(self) -> Counts:
        """How the QPs went so far; `solves` does not count states where no limit was passed."""
        return self._qp.counts

    def details(self) -> dict[str, str]:
        """The counts."""
        return {f"qp {name}": str(count) for name, count in self.counts._asdict().items()}

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains:
        """Those of computed torque: limits that act make the loop no faster."""
        return pd_gains(self._kd * self._slope, self._kd)

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Acceleration that wrong masses cause, over kp."""
        return disturbance(at_rest.a_free) / (self._kd * self._slope)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """As `Controller.effort`.

        Raises:
            SolveError: State, reference or dynamics are not finite, or the effort box is empty.
        """
        a_free, mobility = self.joints.accelerations(x)
        own = self.joints.response(x, (a_free, mobility))
        s, steady = sliding_variable(own, ref, self._slope)
        wanted = np.stack([ref.a - self._kd * s, steady], axis=1)
        _check(own, wanted, box)
        metric = TrackingMetric(own.mobility, self._weight)
        tau, equivalent = metric.efforts(wanted - own.a_free[:, None]).T
        rows, motion = mobility[self._rows], self._limits.box(x)
        a = a_free[self._rows] + rows.dot(tau)
        efforts = np.maximum(box.lower - tau, tau - box.upper).max()
        if efforts <= 0.0 and (motion.lower <= a).all() and (a <= motion.upper).all():
            return Control(tau, s, equivalent, memory[:0], self._idle)
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
        """Effort within limits, and which of them act, from the effort without limits."""
        T = metric.directions()
        lower = np.concatenate([box.lower - tau, motion.lower - a])
        upper = np.concatenate([box.upper - tau, motion.upper - a])
        try:
            found = self._qp.solve(np.concatenate([T, rows.dot(T)]), lower, upper)
        except SolveError:  # counted there; a clipped command is still better than none
            clipped = np.clip(tau, box.lower, box.upper)
            n = len(self._idle) - len(tau)
            return clipped, np.concatenate([clipped != tau, np.zeros(n, dtype=np.bool_)])
        n = len(tau)
        acting = found.side[:n]
        effort = np.clip(tau + T.dot(found.y), box.lower, box.upper)
        effort = np.where(acting > 0, box.lower, np.where(acting < 0, box.upper, effort))
        return effort, self._active(found, motion)

    def _active(self, found: Candidate, motion: AccelerationBox) -> NDArray[np.bool_]:
        n = len(self.joints)
        side = found.side[n:]
        at_position = np.where(side > 0, motion.position_below, motion.position_above)
        at_position &= side != 0
        at_velocity = (side != 0) & ~at_position
        return np.concatenate(
            [
                found.side[:n] != 0,
                at_velocity[self._has_velocity],
                at_position[self._has_position],
            ]
        )


def _check(own: Response, wanted: Array, box: EffortBox) -> None:
    values = (own.q, own.v, own.a_free, own.mobility, wanted)
    if not all(np.isfinite(value).all() for value in values):
        raise SolveError("state, reference or dynamics are not finite")
    if not ((box.lower <= box.upper) & (box.lower < np.inf) & (box.upper > -np.inf)).all():
        raise SolveError("the effort box is empty or not a number")
