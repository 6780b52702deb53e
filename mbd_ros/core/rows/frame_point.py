"""A point or frame on a link, as index of its joint and place there."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_AXES = pin.LOCAL_WORLD_ALIGNED


class FramePoint:
    """A frame that travels with a link.

    Args:
        robot: Robot of the scene.
        frame: Link (or frame) that carries it; the root link of a fixed base or `universe` for one
            at rest.
        point: Its origin in `frame` [m], shape (3,).
        rpy: Its roll, pitch and yaw in `frame` as in URDF [rad], shape (3,).
        keys: What `point` and `rpy` are called in messages.

    Attributes:
        frame: Name of the link.
        joint: Index of the joint that carries it, 0 at rest.
        place: Where it is in the frame of that joint.
        point: Its origin there [m], shape (3,).
        columns: 1 for the velocity coordinates that move it, else 0, shape (nv,).

    Raises:
        ModelError: Unknown frame, or not three finite numbers.
    """

    def __init__(
        self,
        robot: Robot,
        frame: str,
        point: Sequence[float] = (0.0, 0.0, 0.0),
        rpy: Sequence[float] = (0.0, 0.0, 0.0),
        keys: tuple[str, str] = ("point", "rpy"),
    ) -> None:
        link = robot.model.frames[robot.frame(frame)]
        rotation = pin.rpy.rpyToMatrix(checked_vector(keys[1], rpy))
        self.frame = frame
        self.joint = int(link.parentJoint)
        self.place = link.placement * pin.SE3(rotation, checked_vector(keys[0], point))
        self.columns = np.zeros(robot.model.nv)
        for j in robot.model.supports[self.joint]:
            joint = robot.model.joints[j]
            if j:
                self.columns[joint.idx_v : joint.idx_v + joint.nv] = 1.0
        self._model = robot.model
        self.point: Array = self.place.translation.copy()

    def position(self, k: Kinematics) -> Array:
        """Its origin in the world [m], shape (3,), not to be written to."""
        if self.joint == 0:
            return self.point
        position: Array = k.data.oMi[self.joint].act(self.point)
        return position

    def jacobian(self, k: Kinematics) -> Array:
        """From joint velocities to that of its origin in the world, shape (3, nv)."""
        whole = pin.getFrameJacobian(self._model, k.data, self.joint, self.place, _AXES)
        jacobian: Array = whole.reshape(6, -1)[:3]  # with one joint it comes as a vector
        return jacobian

    def velocity(self, k: Kinematics) -> Array:
        """Velocity of its origin in the world [m/s], shape (3,)."""
        if self.joint == 0:
            return np.zeros(3)
        motion = pin.getFrameVelocity(self._model, k.data, self.joint, self.place, _AXES)
        velocity: Array = motion.linear
        return velocity

    def acceleration(self, k: Kinematics) -> Array:
        """Second derivative of its position at zero joint acceleration [m/s^2], shape (3,)."""
        if self.joint == 0:
            return np.zeros(3)
        motion = pin.getFrameClassicalAcceleration(
            self._model, k.data, self.joint, self.place, _AXES
        )
        acceleration: Array = motion.linear
        return acceleration


def checked_vector(key: str, values: Sequence[float]) -> Array:
    """Three finite numbers as an array.

    Args:
        key: What the message calls them.
        values: What was given.

    Raises:
        ModelError: They are not.
    """
    if np.shape(values) != (3,) or not np.isfinite(values).all():
        raise ModelError(f"{key} {values} must be 3 finite numbers")
    return np.array(values, dtype=np.float64)
