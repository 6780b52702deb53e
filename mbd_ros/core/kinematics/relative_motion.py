"""Relative motion of two points with axes on different bodies."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.points import Place
from mbd_ros.core.state import Array

_WORLD, _LOCAL = pin.LOCAL_WORLD_ALIGNED, pin.LOCAL
_STEP = 1.0e-30  # imaginary step, whose square vanishes relative to every real part


class Pose(NamedTuple):
    """Pose of b relative to a, with the same attributes as `pinocchio.SE3`.

    Attributes:
        rotation: Rotation from the axes of b to those of a, shape (3, 3).
        translation: Origin of b in the axes of a [m], shape (3,).
    """

    rotation: Array
    translation: Array


OfPose = Callable[[Pose], tuple[Array, ...]]


class Placed(NamedTuple):
    """Placements of a pair in the world, as `pinocchio.SE3`.

    Attributes:
        joint_a: Placement of the joint that carries a.
        joint_b: Placement of the joint that carries b.
        axes: Frame with the axes of a at the origin of b.
    """

    joint_a: Any
    joint_b: Any
    axes: Any


class PairMotion:
    """Motion of point b relative to point a, based on one Pinocchio `Data`.

    All vectors are expressed in the axes of a; spatial vectors are (linear, angular). The linear
    velocity is the time derivative of the offset from a to b in the axes of a, however far the
    origins are apart. Methods take `placed`, the result of the method of that name, so that
    placements are computed once.

    Args:
        model: Pinocchio model of the robot.
        data: Pinocchio `Data`, refreshed by its owner.
        a: Place of the observer.
        b: Place of the observed point.
        columns: Sign of each velocity coordinate in the relative motion, see `Pair.columns`.
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
        """Return the position of b relative to a [m], shape (3,)."""
        offset: Array = (self._joint_a * self._place_a).actInv(self._joint_b.act(self._point_b))
        return offset

    def pose(self) -> Any:
        """Return the pose of b relative to a, a `pinocchio.SE3`."""
        return (self._joint_a * self._place_a).actInv(self._joint_b * self._place_b)

    def rotation(self) -> Array:
        """Return the rotation from the axes of b to those of a, shape (3, 3)."""
        a, b = self._joint_a * self._place_a, self._joint_b * self._place_b
        rotation: Array = a.rotation.T.dot(b.rotation)
        return rotation

    def placed(self) -> Placed | None:
        """Return the placements, or None for a fixed observer, for which none are needed."""
        return None if self._is_at_rest else self.place()

    def place(self) -> Placed:
        """Return the placements."""
        axes = self._joint_a * self._place_a
        axes.translation = self._joint_b.act(self._point_b)
        return Placed(self._joint_a, self._joint_b, axes)

    def jacobian(self, placed: Placed | None, rows: Any) -> Array:
        """Return rows of the map from joint velocities to the relative twist, shape (m, nv)."""
        jacobian: Array
        if placed is None:
            jacobian_b = self._b_jacobian().reshape(self._all_columns.shape)
            jacobian = self._from_world[rows].dot(jacobian_b)
            return jacobian
        jacobian = placed.axes.toActionMatrixInverse()[rows].dot(self._all_columns)
        jacobian *= self._columns  # joints that move both get exact zeros, not small differences
        return jacobian

    def acceleration(self, placed: Placed | None) -> Array:
        """Return the second derivative of the offset at zero joint acceleration, shape (3,)."""
        if placed is not None:
            return self.motion(placed)[0]
        acceleration: Array = self._to_a.dot(self._b_acceleration().linear)
        return acceleration

    def motion(self, placed: Placed) -> tuple[Array, Array, Array]:
        """Return `acceleration`, angular velocity and its derivative, shape (3,) each."""
        _, a, omega, alpha = self.velocity_and_motion(placed)
        return a, omega, alpha

    def velocity_and_motion(self, placed: Placed) -> tuple[Array, Array, Array, Array]:
        """Return the velocity of b, then the results of `motion`, shape (3,) each."""
        velocity, rate = self.spatial(placed)
        a = pin.classicAcceleration(velocity, rate)
        return velocity.linear, a, velocity.angular, rate.angular

    def directional_derivative(
        self, function: OfPose, pose: Any, rates: Pose
    ) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Return the values of a function of the pose, and their time derivatives.

        Derivatives are computed by a complex step.

        Source: J. R. R. A. Martins, P. Sturdza, J. J. Alonso, The complex-step derivative
        approximation, ACM TOMS 29, 2003.

        Args:
            function: Function of the pose that accepts complex numbers.
            pose: Pose of b relative to a.
            rates: Time derivative of the pose.
        """
        rotation = pose.rotation + 1j * _STEP * rates.rotation
        values = function(Pose(rotation, pose.translation + 1j * _STEP * rates.translation))
        return tuple(v.real for v in values), tuple(v.imag / _STEP for v in values)

    def spatial(self, placed: Placed) -> tuple[Any, Any]:
        """Return the relative twist and its derivative at zero joint acceleration.

        Both are `pinocchio.Motion`. With spatial velocities V and accelerations A, the derivative
        of V_b - V_a in the axes of a is A_b - A_a + (V_b - V_a) x V_a.

        Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 2.10 and 2.11.
        """
        model, data, a, b = self._model, self._data, self._a, self._b
        at_b = placed.joint_b.actInv(placed.axes)
        velocity = pin.getFrameVelocity(model, data, b, at_b, _LOCAL)
        rate = pin.getFrameAcceleration(model, data, b, at_b, _LOCAL)
        if a:
            at_a = placed.joint_a.actInv(placed.axes)
            velocity_a = pin.getFrameVelocity(model, data, a, at_a, _LOCAL)
            velocity -= velocity_a
            rate -= pin.getFrameAcceleration(model, data, a, at_a, _LOCAL)
            rate += velocity.cross(velocity_a)
        return velocity, rate
