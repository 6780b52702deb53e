"""Two bodies that may touch: which features they have, in slots that never change.

`contact_pair` picks the features by the kinds of both shapes; `ContactPair` evaluates them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.geometry.feature_gaps import Meeting, nearest_bases
from mbd_ros.core.geometry.shapes import (
    Balls,
    Between,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Mesh,
    Points,
    Polyhedron,
    Shape,
    Side,
    Sphere,
    balls_of,
    box_of,
    line_of,
    prism_of,
    suffix,
)
from mbd_ros.core.geometry.simple_bodies import BallsOnBalls, BallsOnPlane
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.points import Pair, Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_BACK = np.array((1.0, 1.0, -1.0))  # rows of a contact as the other body counts them
_TURN = np.array((-1.0, 1.0, -1.0))  # and its axes x, y, z
_ROUND = (Sphere, Points)
_WITH_FACES = (Box, Capsule, Cylinder, Mesh)
_OF_BALLS = (*_ROUND, Box, Capsule, Mesh)  # where they meet a plane


def contact_pair(robot: Robot, between: Between, margin: float = 0.0) -> ContactPair:
    """The features of two bodies.

    Args:
        margin: Distance at which surfaces count as touching [m].

    Raises:
        ModelError: The bodies do not move against each other, or nobody knows how their shapes
            touch.
    """
    sides = []
    for side, other in (between, between[::-1]):
        if _has_plane(side) and len(side.shapes) > 1:
            raise ModelError(f"{side.frame}: a half space goes by itself, without other shapes")
        sides.append(_items(robot, side, _OF_BALLS if _has_plane(other) else _ROUND))
    a, b = sides
    met = [_meet(robot, one, other) for one in a for other in b]
    if len(met) > 1:
        _tell_apart(between, [item[0] for item in a], [item[0] for item in b], met)
    return ContactPair(between, tuple(met), margin, _reach(robot, met))


def _has_plane(side: Side) -> bool:
    return any(isinstance(shape, HalfSpace) for shape in side.shapes)


def _items(robot: Robot, side: Side, round_: tuple[type, ...]) -> list[tuple[str, Any]]:
    """All balls of a side together, and its other shapes, each with what features end with."""
    balls = [i for i, shape in enumerate(side.shapes) if isinstance(shape, round_)]
    items: list[tuple[str, Any]] = [("", balls_of(robot, side, balls))] if balls else []
    rest = ((i, shape) for i, shape in enumerate(side.shapes) if i not in balls)
    return [*items, *((suffix(side, i), shape) for i, shape in rest)]


def _meet(robot: Robot, a: tuple[str, Any], b: tuple[str, Any]) -> Met:
    one, other = a[1], b[1]
    found = _meeting(robot, one, other)
    if found is not None:
        return Met(found, False)
    found = _meeting(robot, other, one)
    if found is not None:
        return Met(found, True)
    raise ModelError("a half space and a half space cannot touch; give one of them a shape")


def _meeting(robot: Robot, moving: Any, resting: Any) -> Meeting | None:
    """Features of what moves over what rests, None where the other way round is known."""
    if isinstance(moving, Balls):
        return _balls_on(robot, moving, resting)
    if isinstance(resting, HalfSpace) and isinstance(moving, Cylinder):
        from mbd_ros.core.geometry.simple_bodies import CylinderOnPlane

        return CylinderOnPlane(robot.pair(resting.at, moving.at), moving)
    if isinstance(moving, Box) and isinstance(resting, Box):
        from mbd_ros.core.geometry.boxes import BoxOnBox

        return BoxOnBox(robot.pair(resting.at, moving.at), moving.sides, resting.sides)
    if isinstance(moving, _WITH_FACES) and isinstance(resting, _WITH_FACES):
        from mbd_ros.core.geometry.convex import ConvexOnConvex

        pair = robot.pair(resting.at, moving.at)
        return ConvexOnConvex(pair, _faces_of(moving), _faces_of(resting))
    return None


def _balls_on(robot: Robot, balls: Balls, resting: Shape | Balls) -> Meeting | None:
    pair = robot.pair(resting.at, balls.at)
    if isinstance(resting, HalfSpace):
        return BallsOnPlane(pair, balls)
    if isinstance(resting, Balls):
        k = Kinematics(robot)
        k.refresh(robot.neutral(), np.zeros(robot.model.nv), Reads.POSITION)
        basis = nearest_bases(k.motion(pair).offset()[None])[0]
        return BallsOnBalls(pair, balls, resting, basis)
    if isinstance(resting, Box | Capsule | Cylinder | Mesh):
        from mbd_ros.core.geometry.simple_bodies import BallsOnSolid

        return BallsOnSolid(pair, balls, resting)
    return None


def _faces_of(shape: Box | Capsule | Cylinder | Mesh) -> Polyhedron:
    if isinstance(shape, Mesh):
        return shape.body
    if isinstance(shape, Box):
        return box_of(shape.sides)
    if isinstance(shape, Capsule):
        return line_of(shape.radius, shape.length)
    return prism_of(shape.radius, shape.length)


def _tell_apart(between: Between, a: list[str], b: list[str], met: list[Met]) -> None:
    """Give features of several shapes names of their own."""
    ends = [f"{one}{other.replace('_of_', '_on_')}" for one in a for other in b]
    for (meeting, _), end in zip(met, ends, strict=True):
        meeting.features = tuple(f"{name}{end}" for name in meeting.features)


def _reach(robot: Robot, met: Sequence[Met]) -> float:
    """How far points that may touch are from the moving point of the first pair [m]."""
    if any(one.is_back is not met[0].is_back for one in met):
        return math.inf
    at = [robot.places.points[one.meeting.pair.b.number].at.translation for one in met]
    ways = [float(np.linalg.norm(point - at[0])) for point in at]
    return max(way + one.meeting.reach for way, one in zip(ways, met, strict=True))


class ContactPair:
    """Features between two bodies a and b; rows of feature i are 3 i (normal), 3 i + 1, 3 i + 2.

    The contact frame of a feature has its z along the normal out of b. Its tangents are fixed to
    b where b is flat, else to a where a is. Velocities are those of a past b at the contact
    point, which both bodies are pushed at.

    Args:
        margin: Distance at which surfaces count as touching [m].
        reach: Of the body that moves in the first of them, from its point there [m].

    Attributes:
        features: Names of the slots, fixed while building.
        is_smooth: Whether gaps are twice differentiable, so that events can be found.
        why_not: Why they are not; empty where they are.
        points: A point of a and one of b.
        bodies: The body at rest and the moving one, and how far points of this one that may touch
            are from its point at most [m]; inf where nobody knows.
    """

    def __init__(
        self, between: Between, met: tuple[Met, ...], margin: float, reach: float
    ) -> None:
        self.between = between
        self.features = tuple(name for one in met for name in one.meeting.features)
        self.why_not = next((m.meeting.why_not for m in met if m.meeting.why_not), "")
        self.is_smooth = not self.why_not
        self._met = met
        self._margin = margin
        pair = met[0].meeting.pair
        self.bodies: tuple[Pair, float] = (pair, reach)
        self.points: tuple[Point, Point] = (pair.b, pair.a)
        if met[0].is_back:
            self.points = pair.a, pair.b
        self._signs = np.tile(_BACK, len(self.features))
        self._only = met[0] if len(met) == 1 else None

    def gaps(self, k: Kinematics) -> Array:
        """Distances of the surfaces less the margin [m], shape (n,)."""
        each = [one.meeting.gaps(k.motion(one.meeting.pair)) for one in self._met]
        gaps = each[0] if self._only else np.concatenate(each)
        return gaps - self._margin if self._margin else gaps

    def room(self, k: Kinematics, gaps: Array) -> float:
        """How far the bodies are from touching at least [m].

        Args:
            k: Kinematics at a state.
            gaps: At this state, shape (n,).
        """
        rooms, begin = [], 0
        for meeting, _ in self._met:
            end = begin + len(meeting.features)
            rooms.append(meeting.room(k.motion(meeting.pair), gaps[begin:end] + self._margin))
            begin = end
        return min(rooms) - self._margin

    def jacobian(self, k: Kinematics) -> Array:
        """From joint velocities to those of a past b, shape (3 n, nv)."""
        each = []
        for meeting, is_back in self._met:
            seen = k.motion(meeting.pair)
            jacobian = meeting.jacobian(seen)
            if is_back:
                jacobian *= self._signs[: len(jacobian), None]
            each.append(jacobian)
        return each[0] if self._only else np.concatenate(each)

    def drift(self, k: Kinematics, x: State) -> Array:
        """J' v, shape (3 n,)."""
        each = []
        for meeting, is_back in self._met:
            seen = k.motion(meeting.pair)
            drift = meeting.drift(seen)
            if is_back:
                drift *= self._signs[: len(drift)]
            each.append(drift)
        return each[0] if self._only else np.concatenate(each)

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, for the contact points and frames of one."""
        each = []
        for meeting, is_back in self._met:
            seen = k.motion(meeting.pair)
            jacobian, drift = meeting.accelerations(seen)
            if is_back:
                signs = self._signs[: len(drift)]
                jacobian, drift = jacobian * signs[:, None], drift * signs
            each.append((jacobian, drift))
        if self._only:
            return each[0]
        jacobian, drift = (np.concatenate(part) for part in zip(*each, strict=True))
        return jacobian, drift

    def places(self, k: Kinematics) -> ContactFrames:
        """Contact points and frames in the world."""
        each = [self._places(k, *one) for one in self._met]
        if self._only:
            return each[0]
        point, axes = (np.concatenate(part) for part in zip(*each, strict=True))
        return ContactFrames(point, axes)

    def _places(self, k: Kinematics, meeting: Meeting, is_back: bool) -> ContactFrames:
        _, lever, axes = meeting.touch(k.motion(meeting.pair).pose())
        fixed = k.rotation(meeting.pair.a)
        point = k.position(meeting.pair.b) + lever.dot(fixed.T)
        columns = np.einsum("ij,nkj->nik", fixed, axes[:, [1, 2, 0]])
        return ContactFrames(point, columns * _TURN if is_back else columns)


class Met(NamedTuple):
    """Some features of a pair.

    Attributes:
        is_back: Whether it is b that moves in it.
    """

    meeting: Meeting
    is_back: bool


class ContactFrames(NamedTuple):
    """Where features touch.

    Attributes:
        point: In the world less `Robot.origin` [m], shape (n, 3).
        axes: Contact frames in the world, shape (n, 3, 3), columns x, y, z; z is the normal.
    """

    point: Array
    axes: Array


def distance_to_mass(robot: Robot, pair: ContactPair) -> float:
    """Farthest way of a feature to the nearer mass centre of the moving bodies [m].

    It is the size by which a depth is large or small: the radius of a ball, half the diagonal of a
    box. It is taken in the neutral configuration.
    """
    k = Kinematics(robot)
    k.refresh(robot.neutral(), np.zeros(robot.model.nv), Reads.POSITION)
    touching, ways = pair.places(k).point, []
    for point in pair.points:
        joint = robot.places.points[point.number].joint
        if joint:
            carrier = robot.carrier(point.frame)
            lever = np.asarray(robot.model.inertias[joint].lever)
            centre = k.position(carrier) + k.rotation(carrier).dot(lever)
            ways.append(np.linalg.norm(touching - centre, axis=1))
    return float(np.min(ways, axis=0).max())
