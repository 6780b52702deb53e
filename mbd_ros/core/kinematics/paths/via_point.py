"""Points that a path goes through: held by a link, moved along it by a joint, there or not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics
from mbd_ros.core.model.coupling_functions import CouplingFunction
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.state import Array, State

_NUMBERED = tuple(enumerate("xyz"))


class ViaPoint:
    """A point that a link holds.

    Args:
        point: Where it is in the axes of the link [m], shape (3,).
        within: Where in the motion of a joint the path goes through it; None: everywhere.

    Attributes:
        point: As kinematics know it.
        frame: Name of the link.
        moves: Whether any joint moves it.
        is_held: By its link, at one place.
        joint: The joint that slides it along its link; None where it is held.
        directions: Ways that it slides, in axes of the joint that carries it, shape (3,), each
            with its function of the position of `joint` [m].
    """

    is_held = True
    joint: Joint | None = None
    directions: Sequence[tuple[Array, CouplingFunction]] = ()

    def __init__(
        self, robot: Robot, frame: str, point: Sequence[float], within: Interval | None = None
    ) -> None:
        self.point: Point = robot.point(frame, point)
        self.frame = frame
        self.moves = self.point.moves
        self.within = within

    def position(self, k: Kinematics, x: State) -> Array:
        """Where it is, less `Robot.origin` [m], shape (3,), not to be written to."""
        return k.position(self.point)

    def velocity(self, k: Kinematics, x: State) -> Array:
        """Return its velocity [m/s], shape (3,)."""
        return k.velocity(self.point)

    def acceleration(self, k: Kinematics, x: State) -> Array:
        """Return its acceleration at zero joint acceleration [m/s^2], shape (3,)."""
        return k.acceleration(self.point)

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the map from joint velocities to its velocity, shape (3, nv)."""
        return k.jacobian(self.point)

    def sampled(self, k: SampledKinematics) -> Array:
        """Return its positions in n samples relative to `Robot.origin` [m], shape (n, 3)."""
        return k.position(self.point)

    def slide(self, k: SampledKinematics) -> tuple[int, Array] | None:
        """Return the coordinate that moves it on its link, and its derivative, shape (n, 3)."""
        return None


class MovingViaPoint(ViaPoint):
    """A point that slides along its link as a joint moves: p = p_0 + sum s_i(q) e_i.

    The e_i are axes of the link, each the difference of two points 1 m apart, so that velocities
    and accelerations follow from those of points of the link.

    Source: A. Seth et al., OpenSim, PLoS Comput. Biol. 14, 2018, e1006223: moving path points.

    Args:
        point: Its coordinates in the axes of the link [m], shape (3,); those that a function
            gives are not read.
        joint: The joint that moves it.
        functions: x, y or z -> that coordinate, as function of the position of the joint [m].
    """

    is_held = False

    def __init__(
        self,
        robot: Robot,
        frame: str,
        point: Sequence[float],
        joint: str,
        functions: Mapping[str, CouplingFunction],
        within: Interval | None = None,
    ) -> None:
        begin = np.array([0.0 if axis in functions else float(point[i]) for i, axis in _NUMBERED])
        super().__init__(robot, frame, begin.tolist(), within)
        self._joint = robot.joint(joint)
        self.moves = True
        self.joint = self._joint
        self._axes = [
            (robot.point(frame, (begin + np.eye(3)[i]).tolist()), functions[axis])
            for i, axis in _NUMBERED
            if axis in functions
        ]
        places = robot.places.points
        rotation = places[self.point.number].at.rotation
        self.directions = [
            (rotation[:, i], functions[axis]) for i, axis in _NUMBERED if axis in functions
        ]

    def position(self, k: Kinematics, x: State) -> Array:
        """Return its position relative to `Robot.origin` [m], shape (3,)."""
        q, begin = k.item(x.q, self._joint.q), k.position(self.point)
        return begin + sum((k.position(end) - begin) * f(q)[0] for end, f in self._axes)

    def velocity(self, k: Kinematics, x: State) -> Array:
        """Return its velocity [m/s], shape (3,)."""
        q, rate = k.item(x.q, self._joint.q), k.item(x.v, self._joint.v)
        begin, velocity = k.position(self.point), k.velocity(self.point)
        total = velocity
        for end, function in self._axes:
            s, slope, _ = function(q)
            total = total + (k.velocity(end) - velocity) * s
            total = total + (k.position(end) - begin) * (slope * rate)
        return total

    def acceleration(self, k: Kinematics, x: State) -> Array:
        """Return its acceleration at zero joint acceleration [m/s^2], shape (3,)."""
        q, rate = k.item(x.q, self._joint.q), k.item(x.v, self._joint.v)
        begin, velocity = k.position(self.point), k.velocity(self.point)
        acceleration = k.acceleration(self.point)
        total = acceleration
        for end, function in self._axes:
            s, slope, curvature = function(q)
            total = total + (k.acceleration(end) - acceleration) * s
            total = total + (k.velocity(end) - velocity) * (2.0 * slope * rate)
            total = total + (k.position(end) - begin) * (curvature * rate * rate)
        return total

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the map from joint velocities to its velocity, shape (3, nv)."""
        q, begin, jacobian = (
            k.item(x.q, self._joint.q),
            k.position(self.point),
            k.jacobian(self.point),
        )
        total, along = jacobian, 0.0
        for end, function in self._axes:
            s, slope, _ = function(q)
            total = total + (k.jacobian(end) - jacobian) * s
            along = along + (k.position(end) - begin) * slope
        total[:, self._joint.v] += along
        return total

    def sampled(self, k: SampledKinematics) -> Array:
        """Return its positions in n samples relative to `Robot.origin` [m], shape (n, 3)."""
        offset, _ = self._offset(k)
        return k.position(self.point, offset)

    def slide(self, k: SampledKinematics) -> tuple[int, Array] | None:
        """Return the coordinate that moves it on its link, and its derivative, shape (n, 3)."""
        _, slope = self._offset(k)
        return self._joint.v, k.along(self.point, slope)

    def _offset(self, k: SampledKinematics) -> tuple[Array, Array]:
        """Return offset and its derivative in the axes of the carrying joint, shape (n, 3)."""
        q = k.q[:, self._joint.q]
        offset, slope = np.zeros((2, len(q), 3))
        for axis, function in self.directions:
            value, rate, _ = function(q)
            offset += np.multiply.outer(np.broadcast_to(value, q.shape), axis)
            slope += np.multiply.outer(np.broadcast_to(rate, q.shape), axis)
        return offset, slope


class Interval(NamedTuple):
    """Positions of a joint, its ends included.

    Attributes:
        lower: Smallest position [rad or m], -inf without one.
        upper: Largest position [rad or m], inf without one.
    """

    joint: Joint
    lower: float
    upper: float

    def holds(self, k: Kinematics, x: State) -> bool:
        """Whether the joint is in the interval."""
        q = k.item(x.q, self.joint.q)
        return k.maximum(self.lower - q, q - self.upper) <= 0.0

    def sampled(self, k: SampledKinematics) -> NDArray[np.bool_]:
        """Return whether the joint is in the interval, in n samples."""
        q = k.q[:, self.joint.q]
        there: NDArray[np.bool_] = (q >= self.lower) & (q <= self.upper)
        return there


def slopes_of(
    k: SampledKinematics, points: Sequence[ViaPoint], places: Array, change: Array
) -> Array:
    """Return J of n samples, shape (n, nv), of a length that depends on points.

    Args:
        k: Kinematics at the samples.
        points: The m points.
        places: Positions of the points, shape (n, m, 3).
        change: Derivatives of the length by the positions, shape (n, m, 3).
    """
    arms = np.cross(places, change)
    wrenches: dict[int, Array] = {}
    for i, point in enumerate(points):
        if point.point.moves:
            wrench = np.concatenate((change[:, i], arms[:, i]), axis=-1)
            joint = k.carrier(point.point)
            wrenches[joint] = wrenches[joint] + wrench if joint in wrenches else wrench
    slopes = k.slope(wrenches)
    for i, point in enumerate(points):
        if (slide := point.slide(k)) is not None:
            slopes[:, slide[0]] += (change[:, i] * slide[1]).sum(axis=-1)
    return slopes
