"""Ankle torque that pushes a leg off the ground late in stance."""

from typing import Annotated, Literal

import numpy as np

from mbd_ros.core.contracts import Internal, Load, Now, Output, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotZero, Positive, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class PushOff(Load):
    """Torque on a leg that rises smoothly, with a lag, once a joint has passed an angle.

        tau = torque * activation,   s = (q - angle) / width,
        lag activation' = (1 + s / sqrt(1 + s^2)) / 2 - activation

    The torque acts on `frame` about an axis of the world, and the opposite torque on `against`,
    such as the foot. Without `against`, the opposite torque acts on the ground, as through a foot
    without mass that is flat on the ground and does not tip.

    Args:
        frame: Link (or frame) of the leg.
        joint: Joint whose position measures the progress of stance, such as the hip of a leg on a
            pelvis that does not rotate.
        torque: Largest torque; its sign is the direction about `axis`.
        angle: Joint position at which half of the torque is commanded.
        width: Range of joint positions over which the command rises.
        lag: Time constant of the activation.
        axis: Axis of the world about which the torque acts.
        against: Link (or frame) that the opposite torque acts on; the ground by default.

    Raises:
        ModelError: Unknown joint or frame, or a frame that cannot move.
    """

    reads = Reads.JACOBIAN
    gives_work = True
    internal = (Internal("activation", "", 0.0, 1.0),)
    outputs = (Output("torque", "N·m"),)
    example = {"frame": "foot", "joint": "ankle", "torque": 10.0, "angle": 0.1}

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        joint: str,
        torque: Annotated[NotZero, Unit("N·m")],
        angle: Annotated[float, Unit("rad or m")],
        width: Annotated[Positive, Unit("rad or m")] = 0.05,
        lag: Annotated[Positive, Unit("s")] = 0.05,
        axis: Literal["x", "y", "z"] = "y",
        against: str | None = None,
    ) -> None:
        self.joint = robot.joint(joint)
        self._point = robot.point(frame)
        self._other = None if against is None else robot.point(against)
        if not (self._point.moves or (self._other is not None and self._other.moves)):
            raise ModelError(f"frame '{frame}' cannot move, so a torque on it has no effect")
        self._axis = np.eye(6)[3 + "xyz".index(axis)]
        self._torque = torque
        self._angle = angle
        self._width = width
        self._lag = lag

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau: Array = self._generalized_axis(k) * self._current_torque(k, x)
        return tau

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the rate of the activation [1/s], shape (1,)."""
        return k.array([(self._command(k, x) - k.item(x.z, self.z.start or 0)) / self._lag])

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the commanded activation, shape (1,)."""
        return k.array([self._command(k, x)])

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the torques on its one or two links."""
        at, none = k.position(self._point), np.zeros(3)
        torque = self._axis[3:] * self._current_torque(k, x)
        wrench = Wrench(self._point.frame, at, none, torque)
        if self._other is None:
            return (wrench,)
        return wrench, Wrench(self._other.frame, at, none, -torque)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> tuple[float, ...]:
        """Return the torque [N·m]."""
        return (self._current_torque(k, x),)

    def _current_torque(self, k: Kinematics, x: State) -> float:
        return self._torque * k.item(x.z, self.z.start or 0)

    def _command(self, k: Kinematics, x: State) -> float:
        s = (k.item(x.q, self.joint.q) - self._angle) / self._width
        return 0.5 * (1.0 + s / k.sqrt(1.0 + s * s))

    def _generalized_axis(self, k: Kinematics) -> Array:
        """Return J' times the axis of the torque, summed over both links, shape (nv,)."""
        tau: Array = k.dot(self._axis, k.spatial_jacobian(self._point))
        if self._other is None:
            return tau
        return tau - k.dot(self._axis, k.spatial_jacobian(self._other))
