"""Kinematics k: what a part asks of the mechanism, evaluated at one state."""

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
    """How much of k a part reads at a state; what nothing reads is not refreshed.

    Whatever a part says, its residual, potential and the wrenches of its multipliers read
    positions at most, and its Jacobian reads Jacobians at most.
    """

    NOTHING = 0
    POSITION = 1
    VELOCITY = 2
    JACOBIAN = 3
    DRIFT = 4


class Kinematics:
    """Kinematics in numbers, over a Pinocchio `Data` that its owner refreshes.

    Vectors stand in world axes unless a method says otherwise, spatial ones are (linear, angular).
    The calls of a point are bound when it is first asked for, since parts are shared and a `Data`
    is not. `zeros`, `dot` and the functions after it are those of numbers: a part that uses them
    works on symbols too.

    Args:
        data: Its `Data`; one of its own by default.
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
        model, places, rest = robot.model, robot.places, np.zeros(robot.model.nv)
        data = pin.Data(model) if data is None else data

        def bound(bind: Callable[..., Any], find: Callable[[Any], Any]) -> _Bound:
            return _Bound(partial(bind, model, data), find)

        at, pair = places.points.__getitem__, places.pairs.__getitem__
        self._position = bound(_position, at)
        self._rotation = bound(_rotation, at)
        self._velocity = bound(_velocity, at)
        self._acceleration = bound(_acceleration, at)
        self._jacobian = bound(_jacobian, at)
        self._own_jacobian = bound(_own_jacobian, at)
        self._spatial_jacobian = bound(_spatial_jacobian, at)
        self._motion = bound(PairMotion, pair)
        self._carried = bound(_carried, places.both)
        self._place = partial(pin.forwardKinematics, model, data)
        self._rest = rest
        self._differentiate = partial(pin.computeJointJacobians, model, data)
        self._gravity = partial(pin.computeGeneralizedGravity, model, data)

    def refresh(self, q: Array, v: Array, reads: Reads = Reads.DRIFT) -> None:
        """Bring to a state what is read of it, and nothing else.

        Args:
            reads: How much is read until the next call.
        """
        if not reads:
            return
        if reads >= Reads.DRIFT:
            self._place(q, v, self._rest)
        elif reads >= Reads.VELOCITY:
            self._place(q, v)
        else:
            self._place(q)
        if reads >= Reads.JACOBIAN:
            self._differentiate()

    def position(self, point: Point) -> Array:
        """Where a point is, less `Robot.origin` [m], shape (3,), not to be written to."""
        return self._position[point.number]()

    def rotation(self, point: Point) -> Array:
        """From the axes of a point to those of the world, shape (3, 3)."""
        return self._rotation[point.number]()

    def velocity(self, point: Point) -> Array:
        """Velocity of a point [m/s], shape (3,)."""
        return self._velocity[point.number]()

    def acceleration(self, point: Point) -> Array:
        """Second derivative of a position at zero joint acceleration [m/s^2], shape (3,)."""
        return self._acceleration[point.number]()

    def jacobian(self, point: Point) -> Array:
        """From joint velocities to that of a point, shape (3, nv)."""
        return self._jacobian[point.number]()

    def spatial_jacobian(self, point: Point) -> Array:
        """From joint velocities to velocity and angular velocity of a point, shape (6, nv)."""
        return self._spatial_jacobian[point.number]()

    def local_jacobian(self, point: Point) -> Array:
        """The `spatial_jacobian` in the axes of the point, shape (6, nv)."""
        return self._own_jacobian[point.number]()

    def motion(self, pair: Pair) -> PairMotion:
        """Motion of b as an observer on a sees it."""
        return self._motion[pair.number]

    def transform_wrench(self, wrench: Array, a: Point, b: Point) -> Array:
        """A wrench about a in the axes of a, as one about b in the axes of b, shape (6,).

        Args:
            wrench: Force [N], then torque [N·m], shape (6,).
            a: The point that it is given about.
            b: The point that it is wanted about.
        """
        return self._carried[a.number, b.number](wrench)

    def gravity(self, q: Array) -> Array:
        """Generalized force that holds the robot still, shape (nv,), not to be written to.

        Args:
            q: Configuration, shape (nq,); k need not be refreshed to it.
        """
        return self._gravity(q)

    @staticmethod
    def row(vector: Array) -> Array:
        """A vector as the only row of a matrix, shape (1, n)."""
        return vector.reshape(1, -1)

    def search_path(self, path: Any, x: Any) -> Any:
        """What a path finds by a search at a state, which symbols leave to native code."""
        return path.search(self, x)

    @staticmethod
    def any(values: Array) -> bool:
        """Whether a value is not zero; where nobody can know, it may be so."""
        return bool(values.any())

    @staticmethod
    def hypot(vector: Array) -> float:
        """Length of a vector, exact where squares overflow or vanish."""
        return math.hypot(*vector.tolist())

    @staticmethod
    def within(values: Array, lower: float, upper: float) -> Array:
        """The nearest values between two bounds, shape as `values`."""
        return np.minimum(np.maximum(values, lower), upper)

    @staticmethod
    def choose(least: Array, most: Array, first: Any, second: Any) -> Array:
        """Entry by entry the first value where `least` is not above `most`, else the second."""
        return np.where(least <= most, first, second)

    @staticmethod
    def where(condition: bool, first: Any, second: Any) -> Any:
        """The first value where a condition holds, else the second; both are evaluated."""
        return first if condition else second

    @staticmethod
    def piece(x: float, breaks: Sequence[float], rows: Sequence[Sequence[Any]]) -> Sequence[Any]:
        """The row of the interval that x is in; at a break that of the interval after it.

        Args:
            breaks: Inner ends of the intervals, increasing, n - 1.
            rows: One an interval, n.
        """
        return rows[bisect_right(breaks, x)]

    @staticmethod
    def either(condition: bool, first: Callable[[], Any], second: Callable[[], Any]) -> Any:
        """What the first call gives where a condition holds, else the second; only one is made."""
        return first() if condition else second()


class _Bound(dict[Any, Any]):
    """Calls by number, bound when they are first asked for.

    Args:
        bind: Makes a call of what stands at a number.
        find: What stands at a number; it may come to know more of them.
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
    place = partial(data.oMi[joint].__mul__, at)
    return lambda: place().rotation


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
    whole = _spatial_jacobian(model, data, joint, at)
    return lambda: whole()[:3]


def _spatial_jacobian(model: Any, data: Any, joint: int, at: Any, axes: Any = _WORLD) -> _Call:
    if joint == 0:
        return partial(np.zeros, (6, model.nv))
    whole = partial(pin.getFrameJacobian, model, data, joint, at, axes)
    return whole if model.nv > 1 else lambda: whole().reshape(6, 1)  # Pinocchio gives a vector


def _own_jacobian(model: Any, data: Any, joint: int, at: Any) -> _Call:
    return _spatial_jacobian(model, data, joint, at, _LOCAL)


def _carried(model: Any, data: Any, a: Place, b: Place) -> Callable[[Array], Array]:
    from_a, joint_b = partial(data.oMi[a.joint].__mul__, a.at), data.oMi[b.joint]

    def to_b(load: Any) -> Any:
        return (joint_b * b.at).actInv(load)

    if b.at.isIdentity(0.0):
        to_b = joint_b.actInv
    if a.joint == 0 and a.at.isIdentity():
        return lambda wrench: to_b(pin.Force(wrench)).vector
    return lambda wrench: to_b(from_a().act(pin.Force(wrench))).vector
