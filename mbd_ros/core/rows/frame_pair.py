"""Motion of a frame on one body, seen from a frame on another."""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.rows.frame_point import FramePoint
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_WORLD, _LOCAL = pin.LOCAL_WORLD_ALIGNED, pin.LOCAL


class Placed(NamedTuple):
    """Placements in the world.

    Attributes:
        joint_a: Joint that carries a.
        joint_b: Joint that carries b.
        axes: The axes of a at the origin of b.
    """

    joint_a: Any
    joint_b: Any
    axes: Any


class FramePair:
    """Motion of a frame b as an observer on a frame a sees it.

    All vectors stand in the axes of a, spatial ones are (linear, angular). The linear velocity is
    that of the origin of b past the body of a, so that it is the derivative of the offset however
    far the origins are apart. `placed` is what the method of that name returns.

    Args:
        model: Pinocchio model of the robot.
        a: The frame of the observer.
        b: The observed frame.

    Raises:
        ModelError: They do not move against each other.
    """

    def __init__(self, model: Any, a: FramePoint, b: FramePoint) -> None:
        self.a, self.b = a, b
        self.columns = b.columns - a.columns
        if not self.columns.any():
            raise ModelError(f"frames '{a.frame}' and '{b.frame}' do not move against each other")
        self._model, self._nv = model, int(model.nv)
        self._is_at_rest = a.joint == 0
        self._to_a = a.place.rotation.T.copy()
        self._from_world = np.kron(np.eye(2), self._to_a)  # for an observer at rest

    def offset(self, k: Kinematics) -> Array:
        """Origin of b, from that of a [m], shape (3,)."""
        offset: Array = (k.data.oMi[self.a.joint] * self.a.place).actInv(self.b.position(k))
        return offset

    def rotation(self, k: Kinematics) -> Array:
        """From the axes of b to those of a, shape (3, 3)."""
        places = k.data.oMi
        a, b = places[self.a.joint] * self.a.place, places[self.b.joint] * self.b.place
        rotation: Array = a.rotation.T.dot(b.rotation)
        return rotation

    def placed(self, k: Kinematics) -> Placed | None:
        """Placements of both; None for an observer at rest, which needs none."""
        return None if self._is_at_rest else self.place(k)

    def place(self, k: Kinematics) -> Placed:
        """Where both are."""
        places = k.data.oMi
        joint_a, joint_b = places[self.a.joint], places[self.b.joint]
        axes = joint_a * self.a.place
        axes.translation = joint_b.act(self.b.point)
        return Placed(joint_a, joint_b, axes)

    def jacobian(self, k: Kinematics, placed: Placed | None, rows: slice) -> Array:
        """From joint velocities to rows of the velocity, shape (m, nv)."""
        jacobian: Array
        if placed is None:
            b = self.b
            whole = pin.getFrameJacobian(self._model, k.data, b.joint, b.place, _WORLD)
            jacobian = self._from_world[rows].dot(whole.reshape(6, self._nv))
            return jacobian
        columns = k.data.J.reshape(6, self._nv)  # with one joint it comes as a vector
        jacobian = placed.axes.toActionMatrixInverse()[rows].dot(columns)
        jacobian *= self.columns  # zero, not a small difference, where both frames are carried
        return jacobian

    def acceleration(self, k: Kinematics, placed: Placed | None) -> Array:
        """Second derivative of the offset at zero joint acceleration, shape (3,)."""
        if placed is None:
            acceleration: Array = self._to_a.dot(self.b.acceleration(k))
            return acceleration
        return self.motion(k, placed)[0]

    def motion(self, k: Kinematics, placed: Placed) -> tuple[Array, Array, Array]:
        """Acceleration as above, angular velocity and its derivative, shape (3,) each.

        With spatial velocities V and accelerations A that of b relative to a, differentiated in
        the axes of a, is A_b - A_a + (V_b - V_a) x V_a.

        Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 2.10 and 2.11.
        """
        model, a, b = self._model, self.a.joint, self.b.joint
        at_b = placed.joint_b.actInv(placed.axes)
        velocity = pin.getFrameVelocity(model, k.data, b, at_b, _LOCAL)
        rate = pin.getFrameAcceleration(model, k.data, b, at_b, _LOCAL)
        if a:
            at_a = placed.joint_a.actInv(placed.axes)
            carried = pin.getFrameVelocity(model, k.data, a, at_a, _LOCAL)
            velocity -= carried
            rate -= pin.getFrameAcceleration(model, k.data, a, at_a, _LOCAL)
            rate += velocity.cross(carried)
        return pin.classicAcceleration(velocity, rate), velocity.angular, rate.angular
