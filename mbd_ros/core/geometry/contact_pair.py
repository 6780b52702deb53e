"""Geometry of two bodies in contact: a fixed list of contact features, with gaps and frames.

`contact_pair` chooses the features by the kinds of both shapes; `ContactPair` evaluates them.
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

_BACK = np.array((1.0, 1.0, -1.0))  # signs of contact rows if the bodies are exchanged
_TURN = np.array((-1.0, 1.0, -1.0))  # signs of the axes x, y, z in that case
_ROUND = (Sphere, Points)
_WITH_FACES = (Box, Capsule, Cylinder, Mesh)
_OF_BALLS = (*_ROUND, Box, Capsule, Mesh)  # where they meet a plane


def contact_pair(robot: Robot, between: Between, margin: float = 0.0) -> ContactPair:
    """Return the contact features of two bodies.

    Args:
        robot: The robot.
        between: Shapes of both bodies.
        margin: Distance at which surfaces count as touching [m].

    Raises:
        ModelError: The bodies have no relative motion, or contact of their shapes is not
            supported.
    """
    sides = []
    for side, other in (between, between[::-1]):
        if _has_plane(side) and len(side.shapes) > 1:
            raise ModelError(f"{side.frame}: a half space cannot be combined with other shapes")
        sides.append(_items(robot, side, _OF_BALLS if _has_plane(other) else _ROUND))
    a, b = sides
    meetings = [_meet(robot, shape_a, shape_b) for shape_a in a for shape_b in b]
    if len(meetings) > 1:
        _make_names_unique(between, [item[0] for item in a], [item[0] for item in b], meetings)
    return ContactPair(between, tuple(meetings), margin, _reach(robot, meetings))


def _has_plane(side: Side) -> bool:
    return any(isinstance(shape, HalfSpace) for shape in side.shapes)


def _items(robot: Robot, side: Side, round_: tuple[type, ...]) -> list[tuple[str, Any]]:
    """Return the shapes of a side, all balls as one, each with the suffix of its features."""
    balls = [i for i, shape in enumerate(side.shapes) if isinstance(shape, round_)]
    items: list[tuple[str, Any]] = [("", balls_of(robot, side, balls))] if balls else []
    others = ((i, shape) for i, shape in enumerate(side.shapes) if i not in balls)
    return [*items, *((suffix(side, i), shape) for i, shape in others)]


def _meet(robot: Robot, a: tuple[str, Any], b: tuple[str, Any]) -> Met:
    shape_a, shape_b = a[1], b[1]
    meeting = _meeting(robot, shape_a, shape_b)
    if meeting is not None:
        return Met(meeting, False)
    meeting = _meeting(robot, shape_b, shape_a)
    if meeting is not None:
        return Met(meeting, True)
    raise ModelError("contact of two half spaces is not supported; give one of them a shape")


def _meeting(robot: Robot, moving: Any, resting: Any) -> Meeting | None:
    """Return the features of a moving over a resting shape; None if only the reverse is known."""
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


def _make_names_unique(between: Between, a: list[str], b: list[str], meetings: list[Met]) -> None:
    """Append to the names of features which of several shapes they belong to."""
    ends = [f"{end_a}{end_b.replace('_of_', '_on_')}" for end_a in a for end_b in b]
    for (meeting, _), end in zip(meetings, ends, strict=True):
        meeting.features = tuple(f"{name}{end}" for name in meeting.features)


def _reach(robot: Robot, meetings: Sequence[Met]) -> float:
    """Return the largest distance of contact points from the point of the first pair [m]."""
    if any(met.is_reversed is not meetings[0].is_reversed for met in meetings):
        return math.inf
    points = [robot.places.points[met.meeting.pair.b.number].at.translation for met in meetings]
    distances = [float(np.linalg.norm(point - points[0])) for point in points]
    return max(d + met.meeting.reach for d, met in zip(distances, meetings, strict=True))


class ContactPair:
    """Features between two bodies a and b; rows of feature i are 3 i (normal), 3 i + 1, 3 i + 2.

    The z axis of a contact frame is the normal out of b. Its tangents are fixed to b if b is flat,
    otherwise to a if a is flat. Velocities are those of a relative to b at the contact point, at
    which the forces on both bodies act.

    Args:
        between: Shapes of both bodies.
        met: Features of all pairs of shapes.
        margin: Distance at which surfaces count as touching [m].
        reach: Largest distance of contact points from the moving point of the first pair [m].

    Attributes:
        features: Names of the features, which never change.
        is_smooth: Whether gaps are twice differentiable, so that events can be located.
        why_not: Reason why they are not; empty if they are.
        points: A point of a and one of b.
        bodies: The pair of resting and moving body, and the largest distance of contact points
            from the point of the moving body [m], inf if it is unknown.
    """

    def __init__(
        self, between: Between, met: tuple[Met, ...], margin: float, reach: float
    ) -> None:
        self.between = between
        self.features = tuple(name for m in met for name in m.meeting.features)
        self.why_not = next((m.meeting.why_not for m in met if m.meeting.why_not), "")
        self.is_smooth = not self.why_not
        self._met = met
        self._margin = margin
        pair = met[0].meeting.pair
        self.bodies: tuple[Pair, float] = (pair, reach)
        self.points: tuple[Point, Point] = (pair.b, pair.a)
        if met[0].is_reversed:
            self.points = pair.a, pair.b
        self._signs = np.tile(_BACK, len(self.features))
        self._only = met[0] if len(met) == 1 else None

    def gaps(self, k: Kinematics) -> Array:
        """Return the gaps, distances of the surfaces minus the margin [m], shape (n,)."""
        each = [met.meeting.gaps(k.motion(met.meeting.pair)) for met in self._met]
        gaps = each[0] if self._only else np.concatenate(each)
        return gaps - self._margin if self._margin else gaps

    def clearance(self, k: Kinematics, gaps: Array) -> float:
        """Return a lower bound of the distance of the bodies [m].

        Args:
            k: Kinematics at a state.
            gaps: Gaps at this state, shape (n,).
        """
        clearances, begin = [], 0
        for meeting, _ in self._met:
            end = begin + len(meeting.features)
            motion = k.motion(meeting.pair)
            clearances.append(meeting.clearance(motion, gaps[begin:end] + self._margin))
            begin = end
        return min(clearances) - self._margin

    def jacobian(self, k: Kinematics) -> Array:
        """Return the map from joint velocities to velocities of a relative to b, (3 n, nv)."""
        each = []
        for meeting, is_reversed in self._met:
            seen = k.motion(meeting.pair)
            jacobian = meeting.jacobian(seen)
            if is_reversed:
                jacobian *= self._signs[: len(jacobian), None]
            each.append(jacobian)
        return each[0] if self._only else np.concatenate(each)

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return J' v, shape (3 n,)."""
        each = []
        for meeting, is_reversed in self._met:
            seen = k.motion(meeting.pair)
            drift = meeting.drift(seen)
            if is_reversed:
                drift *= self._signs[: len(drift)]
            each.append(drift)
        return each[0] if self._only else np.concatenate(each)

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift`, which share contact points and frames."""
        each = []
        for meeting, is_reversed in self._met:
            seen = k.motion(meeting.pair)
            jacobian, drift = meeting.accelerations(seen)
            if is_reversed:
                signs = self._signs[: len(drift)]
                jacobian, drift = jacobian * signs[:, None], drift * signs
            each.append((jacobian, drift))
        if self._only:
            return each[0]
        jacobian, drift = (np.concatenate(part) for part in zip(*each, strict=True))
        return jacobian, drift

    def places(self, k: Kinematics) -> ContactFrames:
        """Return contact points and frames in the world."""
        each = [self._places(k, *met) for met in self._met]
        if self._only:
            return each[0]
        point, axes = (np.concatenate(part) for part in zip(*each, strict=True))
        return ContactFrames(point, axes)

    def _places(self, k: Kinematics, meeting: Meeting, is_reversed: bool) -> ContactFrames:
        _, lever, axes = meeting.touch(k.motion(meeting.pair).pose())
        fixed = k.rotation(meeting.pair.a)
        point = k.position(meeting.pair.b) + lever.dot(fixed.T)
        columns = np.einsum("ij,nkj->nik", fixed, axes[:, [1, 2, 0]])
        return ContactFrames(point, columns * _TURN if is_reversed else columns)


class Met(NamedTuple):
    """Features of a pair of shapes.

    Attributes:
        meeting: The features.
        is_reversed: Whether b is the moving body in it.
    """

    meeting: Meeting
    is_reversed: bool


class ContactFrames(NamedTuple):
    """Contact points and contact frames of features.

    Attributes:
        point: Contact points relative to `Robot.origin` [m], shape (n, 3).
        axes: Contact frames in the world, shape (n, 3, 3), columns x, y, z; z is the normal.
    """

    point: Array
    axes: Array


def distance_to_mass(robot: Robot, pair: ContactPair) -> float:
    """Return the largest distance of a feature from the nearer mass centre of both bodies [m].

    It is the length scale of penetrations: the radius of a ball, half the diagonal of a box. It is
    computed in the neutral configuration.
    """
    k = Kinematics(robot)
    k.refresh(robot.neutral(), np.zeros(robot.model.nv), Reads.POSITION)
    contact_points, distances = pair.places(k).point, []
    for point in pair.points:
        joint = robot.places.points[point.number].joint
        if joint:
            carrier = robot.carrier(point.frame)
            lever = np.asarray(robot.model.inertias[joint].lever)
            centre = k.position(carrier) + k.rotation(carrier).dot(lever)
            distances.append(np.linalg.norm(contact_points - centre, axis=1))
    return float(np.min(distances, axis=0).max())
