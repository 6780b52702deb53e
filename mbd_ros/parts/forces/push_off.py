"""Ankle torque that pushes a leg off the ground late in its stance."""

from typing import Annotated, Literal

import numpy as np

from mbd_ros.core.contracts import Internal, Load, Now, Output, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotZero, Positive, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class PushOff(Load):
    """Continuous controller with a memory: a torque on a leg that is past an angle.

        tau = torque * activation,   s = (q - angle) / width,
        lag activation' = (1 + s / sqrt(1 + s^2)) / 2 - activation

    It acts on `frame` about an axis of the world; `against` takes the opposite torque, such as a
    foot. Without it the ground does: a foot flat on the ground, without mass and long enough.

    Args:
        frame: Leg that is pushed.
        joint: Joint whose position says how far the stance is; of a leg that hangs on a pelvis
            which does not turn, its hip.
        torque: Largest one; its sign is that about `axis`.
        angle: Position of the joint at which half of it is asked for.
        width: Over which it grows.
        lag: Time constant of the activation.
        axis: Of the world.
        against: Link (or frame) that takes the opposite torque; the ground by default.

    Raises:
        ModelError: Unknown joint or frame, or a frame that does not move.
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
            raise ModelError(f"frame '{frame}' does not move, a torque on it changes nothing")
        self._axis = np.eye(6)[3 + "xyz".index(axis)]
        self._torque = torque
        self._angle = angle
        self._width = width
        self._lag = lag

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau: Array = self._slopes(k) * self._given(k, x)
        return tau

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Rate of the activation [1/s], shape (1,)."""
        return k.array([(self._asked(k, x) - k.item(x.z, self.z.start or 0)) / self._lag])

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array:
        """The activation that is asked for, shape (1,)."""
        return k.array([self._asked(k, x)])

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The torque on each of its links."""
        at, none = k.position(self._point), np.zeros(3)
        torque = self._axis[3:] * self._given(k, x)
        own = Wrench(self._point.frame, at, none, torque)
        if self._other is None:
            return (own,)
        return own, Wrench(self._other.frame, at, none, -torque)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> tuple[float, ...]:
        """The torque."""
        return (self._given(k, x),)

    def _given(self, k: Kinematics, x: State) -> float:
        return self._torque * k.item(x.z, self.z.start or 0)

    def _asked(self, k: Kinematics, x: State) -> float:
        s = (k.item(x.q, self.joint.q) - self._angle) / self._width
        return 0.5 * (1.0 + s / k.sqrt(1.0 + s * s))

    def _slopes(self, k: Kinematics) -> Array:
        slopes: Array = k.dot(self._axis, k.spatial_jacobian(self._point))
        if self._other is None:
            return slopes
        return slopes - k.dot(self._axis, k.spatial_jacobian(self._other))
