"""Kinematics k of one state: positions, velocities and Jacobians of points."""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from enum import IntEnum
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.kinematics.relative_motion import PairMotion
from mbd_ros.core.model.points import Pair, Place, Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

_WORLD, _LOCAL = pin.LOCAL_WORLD_ALIGNED, pin.LOCAL


class Reads(IntEnum):
    """How much of k a part reads at a state; quantities that no part reads are not computed.

    Regardless of this level, the residual, the potential and the wrenches of a part may read
    positions only, and its Jacobian may read up to Jacobians.
    """

    NOTHING = 0
    POSITION = 1
    VELOCITY = 2
    JACOBIAN = 3
    DRIFT = 4


class Kinematics:
    """Numerical kinematics based on a Pinocchio `Data`, valid after `refresh`.

    Vectors are expressed in world axes unless a method says otherwise; spatial vectors are
    (linear, angular). Mathematical functions such as `zeros`, `dot` and `sqrt` belong to k, so
    that a part which uses them also works on symbols (`mbd_ros.compiled.symbols.kinematics`).

    Calls into Pinocchio are bound to a point at its first use, since parts are shared by several
    systems and a `Data` is not.

    Args:
        robot: The robot.
        data: Pinocchio `Data`; a new one by default.
    """

    zeros = staticmethod(np.zeros)
    item = staticmethod(np.ndarray.item)
    dot: Callable[..., Any] = staticmethod(np.ndarray.dot)
    array: Callable[..., Any] = staticmethod(np.array)
    sqrt, exp, log = staticmethod(math.sqrt), staticmethod(math.exp), staticmethod(math.log)
    tanh, sin, cos = staticmethod(math.tanh), staticmethod(math.sin), staticmethod(math.cos)
    copysign, arctan2 = staticmethod(math.copysign), staticmethod(math.atan2)
    maximum, minimum = staticmethod(max), staticmethod(min)

    def __init__(self, robot: Robot, data: Any = None) -> None:
        model, places = robot.model, robot.places
        data = pin.Data(model) if data is None else data

        def bound(bind: Callable[..., Any], find: Callable[[Any], Any]) -> _BoundCalls:
            return _BoundCalls(partial(bind, model, data), find)

        place, pair = places.points.__getitem__, places.pairs.__getitem__
        self._position = bound(_position, place)
        self._rotation = bound(_rotation, place)
        self._velocity = bound(_velocity, place)
        self._acceleration = bound(_acceleration, place)
        self._jacobian = bound(_jacobian, place)
        self._local_jacobian = bound(_local_jacobian, place)
        self._spatial_jacobian = bound(_spatial_jacobian, place)
        self._motion = bound(PairMotion, pair)
        self._wrench_transform = bound(_wrench_transform, places.both)
        self._forward_kinematics = partial(pin.forwardKinematics, model, data)
        self._zero_acceleration = np.zeros(robot.model.nv)
        self._compute_jacobians = partial(pin.computeJointJacobians, model, data)
        self._gravity = partial(pin.computeGeneralizedGravity, model, data)

    def refresh(self, q: Array, v: Array, reads: Reads = Reads.DRIFT) -> None:
        """Compute what is read at a state.

        Args:
            q: Configuration, shape (nq,).
            v: Velocity, shape (nv,).
            reads: How much is read until the next call.
        """
        if not reads:
            return
        if reads >= Reads.DRIFT:
            self._forward_kinematics(q, v, self._zero_acceleration)
        elif reads >= Reads.VELOCITY:
            self._forward_kinematics(q, v)
        else:
            self._forward_kinematics(q)
        if reads >= Reads.JACOBIAN:
            self._compute_jacobians()

    def position(self, point: Point) -> Array:
        """Return the position of a point relative to `Robot.origin` [m], shape (3,), read-only."""
        return self._position[point.number]()

    def rotation(self, point: Point) -> Array:
        """Return the rotation from the axes of a point to those of the world, shape (3, 3)."""
        return self._rotation[point.number]()

    def velocity(self, point: Point) -> Array:
        """Return the velocity of a point [m/s], shape (3,)."""
        return self._velocity[point.number]()

    def acceleration(self, point: Point) -> Array:
        """Return the acceleration of a point at zero joint acceleration [m/s^2], shape (3,)."""
        return self._acceleration[point.number]()

    def jacobian(self, point: Point) -> Array:
        """Return the map from joint velocities to the velocity of a point, shape (3, nv)."""
        return self._jacobian[point.number]()

    def spatial_jacobian(self, point: Point) -> Array:
        """Return the map from joint velocities to the twist of a point, shape (6, nv)."""
        return self._spatial_jacobian[point.number]()

    def local_jacobian(self, point: Point) -> Array:
        """Return the `spatial_jacobian` in the axes of the point, shape (6, nv)."""
        return self._local_jacobian[point.number]()

    def motion(self, pair: Pair) -> PairMotion:
        """Return the motion of point b relative to point a."""
        return self._motion[pair.number]

    def transform_wrench(self, wrench: Array, a: Point, b: Point) -> Array:
        """Express a wrench about a, in the axes of a, about b in the axes of b, shape (6,).

        Args:
            wrench: Force [N], then torque [N·m], shape (6,).
            a: Point that the wrench refers to.
            b: Point that the result refers to.
        """
        return self._wrench_transform[a.number, b.number](wrench)

    def gravity(self, q: Array) -> Array:
        """Return the generalized force that balances gravity, shape (nv,), read-only.

        Args:
            q: Configuration, shape (nq,); k need not be refreshed at it.
        """
        return self._gravity(q)

    @staticmethod
    def row(vector: Array) -> Array:
        """Return a vector as a matrix with one row, shape (1, n)."""
        return vector.reshape(1, -1)

    def search_path(self, path: Any, x: Any) -> Any:
        """Return the shortest path by search; symbolic kinematics leave it to native code."""
        return path.search(self, x)

    @staticmethod
    def any(values: Array) -> bool:
        """Whether any value is nonzero; symbols return True, since it cannot be known."""
        return bool(values.any())

    @staticmethod
    def hypot(vector: Array) -> float:
        """Return the length of a vector, without overflow or underflow of squares."""
        return math.hypot(*vector.tolist())

    @staticmethod
    def within(values: Array, lower: float, upper: float) -> Array:
        """Return the values clipped to two bounds, with the shape of `values`."""
        return np.minimum(np.maximum(values, lower), upper)

    @staticmethod
    def choose(least: Array, most: Array, first: Any, second: Any) -> Array:
        """Return, per entry, the first value where `least` <= `most`, otherwise the second."""
        return np.where(least <= most, first, second)

    @staticmethod
    def where(condition: bool, first: Any, second: Any) -> Any:
        """Return the first value if a condition holds, otherwise the second; both are computed."""
        return first if condition else second

    @staticmethod
    def piece(x: float, breaks: Sequence[float], rows: Sequence[Sequence[Any]]) -> Sequence[Any]:
        """Return the row of the interval that contains x; a break belongs to the next interval.

        Args:
            x: Argument.
            breaks: Increasing inner ends of the n intervals, n - 1 numbers.
            rows: One row per interval, n rows.
        """
        return rows[bisect_right(breaks, x)]

    @staticmethod
    def either(condition: bool, first: Callable[[], Any], second: Callable[[], Any]) -> Any:
        """Return the result of the first call if a condition holds, otherwise of the second.

        Only one of the two is called.
        """
        return first() if condition else second()


class _BoundCalls(dict[Any, Any]):
    """Calls by the number of a point or pair, bound at their first use.

    Args:
        bind: Function that binds a call to the place of a point, or the places of a pair.
        find: Function that returns the place, or places, of a number.
    """

    def __init__(self, bind: Callable[..., Any], find: Callable[[Any], Any]) -> None:
        super().__init__()
        self._bind = bind
        self._find = find

    def __missing__(self, number: Any) -> Any:
        call = self[number] = self._bind(*self._find(number))
        return call


_Call = Callable[[], Array]


def _position(model: Any, data: Any, joint: int, at: Any) -> _Call:
    if joint == 0:
        return at.translation.copy
    return partial(data.oMi[joint].act, at.translation.copy())  # a live view


def _rotation(model: Any, data: Any, joint: int, at: Any) -> _Call:
    pose = partial(data.oMi[joint].__mul__, at)
    return lambda: pose().rotation


def _velocity(model: Any, data: Any, joint: int, at: Any) -> _Call:
    if joint == 0:
        return partial(np.zeros, 3)
    motion = partial(pin.getFrameVelocity, model, data, joint, at, _WORLD)
    return lambda: motion().linear


def _acceleration(model: Any, data: Any, joint: int, at: Any) -> _Call:
    if joint == 0:
        return partial(np.zeros, 3)
    motion = partial(pin.getFrameClassicalAcceleration, model, data, joint, at, _WORLD)
    return lambda: motion().linear


def _jacobian(model: Any, data: Any, joint: int, at: Any) -> _Call:
    spatial = _spatial_jacobian(model, data, joint, at)
    return lambda: spatial()[:3]


def _spatial_jacobian(model: Any, data: Any, joint: int, at: Any, axes: Any = _WORLD) -> _Call:
    if joint == 0:
        return partial(np.zeros, (6, model.nv))
    jacobian = partial(pin.getFrameJacobian, model, data, joint, at, axes)
    if model.nv > 1:
        return jacobian
    return lambda: jacobian().reshape(6, 1)  # with one joint, Pinocchio returns a vector


def _local_jacobian(model: Any, data: Any, joint: int, at: Any) -> _Call:
    return _spatial_jacobian(model, data, joint, at, _LOCAL)


def _wrench_transform(model: Any, data: Any, a: Place, b: Place) -> Callable[[Array], Array]:
    from_a, joint_b = partial(data.oMi[a.joint].__mul__, a.at), data.oMi[b.joint]

    def to_b(force: Any) -> Any:
        return (joint_b * b.at).actInv(force)

    if b.at.isIdentity(0.0):
        to_b = joint_b.actInv
    if a.joint == 0 and a.at.isIdentity():
        return lambda wrench: to_b(pin.Force(wrench)).vector
    return lambda wrench: to_b(from_a().act(pin.Force(wrench))).vector
