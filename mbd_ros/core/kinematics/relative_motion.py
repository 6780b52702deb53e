"""Motion of a point with axes, seen by an observer on another body."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.points import Place
from mbd_ros.core.state import Array

_WORLD, _LOCAL = pin.LOCAL_WORLD_ALIGNED, pin.LOCAL
_STEP = 1.0e-30  # imaginary, so small that its square vanishes beside every real part


class Pose(NamedTuple):
    """Where b is; `pinocchio.SE3` has the same attributes.

    Attributes:
        rotation: From its axes to those of a, shape (3, 3).
        translation: Of its origin [m], shape (3,).
    """

    rotation: Array
    translation: Array


OfPose = Callable[[Pose], tuple[Array, ...]]


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


class PairMotion:
    """Motion of b as an observer on a sees it, over one Pinocchio `Data`.

    All vectors stand in the axes of a, spatial ones are (linear, angular). The linear velocity is
    that of the origin of b past the body of a, so that it is the derivative of the offset however
    far the origins are apart. `placed` is what the method of that name returns.

    Args:
        model: Pinocchio model of the robot.
        a: Where the observer stands.
        b: Where the observed point stands.
        columns: As `Pair.columns`.
    """

    def __init__(self, model: Any, data: Any, a: Place, b: Place, columns: Array) -> None:
        self._model = model
        self._data = data
        self._columns = columns
        self._a = a.joint
        self._b = b.joint
        self._place_a = a.at
        self._place_b = b.at
        self._joint_a = data.oMi[a.joint]
        self._joint_b = data.oMi[b.joint]  # live views
        self._all_columns = data.J.reshape(6, int(model.nv))  # with one joint it is a vector
        self._point_b = b.at.translation.copy()
        at_b = model, data, b.joint, b.at, _WORLD
        self._b_jacobian = partial(pin.getFrameJacobian, *at_b)
        self._b_acceleration = partial(pin.getFrameClassicalAcceleration, *at_b)
        self._is_at_rest = a.joint == 0
        self._to_a = a.at.rotation.T.copy()
        self._from_world = np.kron(np.eye(2), self._to_a)  # for an observer at rest

    def offset(self) -> Array:
        """Origin of b, from that of a [m], shape (3,)."""
        offset: Array = (self._joint_a * self._place_a).actInv(self._joint_b.act(self._point_b))
        return offset

    def pose(self) -> Any:
        """The `pinocchio.SE3` of b in the axes of a."""
        return (self._joint_a * self._place_a).actInv(self._joint_b * self._place_b)

    def rotation(self) -> Array:
        """From the axes of b to those of a, shape (3, 3)."""
        a, b = self._joint_a * self._place_a, self._joint_b * self._place_b
        rotation: Array = a.rotation.T.dot(b.rotation)
        return rotation

    def placed(self) -> Placed | None:
        """Placements of both; None for an observer at rest, which needs none."""
        return None if self._is_at_rest else self.place()

    def place(self) -> Placed:
        """Where both are."""
        axes = self._joint_a * self._place_a
        axes.translation = self._joint_b.act(self._point_b)
        return Placed(self._joint_a, self._joint_b, axes)

    def jacobian(self, placed: Placed | None, rows: Any) -> Array:
        """From joint velocities to rows of the velocity, shape (m, nv)."""
        jacobian: Array
        if placed is None:
            whole = self._b_jacobian().reshape(self._all_columns.shape)
            jacobian = self._from_world[rows].dot(whole)
            return jacobian
        jacobian = placed.axes.toActionMatrixInverse()[rows].dot(self._all_columns)
        jacobian *= self._columns  # zero, not a small difference, where both frames are carried
        return jacobian

    def acceleration(self, placed: Placed | None) -> Array:
        """Second derivative of the offset at zero joint acceleration, shape (3,)."""
        if placed is not None:
            return self.motion(placed)[0]
        acceleration: Array = self._to_a.dot(self._b_acceleration().linear)
        return acceleration

    def motion(self, placed: Placed) -> tuple[Array, Array, Array]:
        """Acceleration as above, angular velocity and its derivative, shape (3,) each."""
        _, a, omega, alpha = self.moving(placed)
        return a, omega, alpha

    def moving(self, placed: Placed) -> tuple[Array, Array, Array, Array]:
        """The velocity of the origin of b, then what `motion` gives, shape (3,) each."""
        velocity, rate = self.spatial(placed)
        a = pin.classicAcceleration(velocity, rate)
        return velocity.linear, a, velocity.angular, rate.angular

    def along(
        self, function: OfPose, pose: Any, rates: Pose
    ) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """What a function of the pose gives, and its rates along a motion, by a complex step.

        Source: J. R. R. A. Martins, P. Sturdza, J. J. Alonso, The complex-step derivative
        approximation, ACM TOMS 29, 2003.

        Args:
            function: Goes with complex numbers.
        """
        turned = pose.rotation + 1j * _STEP * rates.rotation
        found = function(Pose(turned, pose.translation + 1j * _STEP * rates.translation))
        return tuple(one.real for one in found), tuple(one.imag / _STEP for one in found)

    def spatial(self, placed: Placed) -> tuple[Any, Any]:
        """Velocity and acceleration of b, at zero joint acceleration: two `pinocchio.Motion`.

        With spatial velocities V and accelerations A that of b relative to a, differentiated in
        the axes of a, is A_b - A_a + (V_b - V_a) x V_a.

        Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 2.10 and 2.11.
        """
        model, data, a, b = self._model, self._data, self._a, self._b
        at_b = placed.joint_b.actInv(placed.axes)
        velocity = pin.getFrameVelocity(model, data, b, at_b, _LOCAL)
        rate = pin.getFrameAcceleration(model, data, b, at_b, _LOCAL)
        if a:
            at_a = placed.joint_a.actInv(placed.axes)
            carried = pin.getFrameVelocity(model, data, a, at_a, _LOCAL)
            velocity -= carried
            rate -= pin.getFrameAcceleration(model, data, a, at_a, _LOCAL)
            rate += velocity.cross(carried)
        return velocity, rate
