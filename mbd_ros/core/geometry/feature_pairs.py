"""Which features two bodies have, by the kinds of their shapes."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.geometry.contact_pair import ContactPair, Met
from mbd_ros.core.geometry.feature_gaps import Meeting
from mbd_ros.core.geometry.frames import nearest_bases
from mbd_ros.core.geometry.polyhedron import Polyhedron, box_of, line_of, prism_of
from mbd_ros.core.geometry.shapes import (
    Balls,
    Between,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Mesh,
    Points,
    Shape,
    Side,
    Sphere,
    balls_of,
    suffix,
)
from mbd_ros.core.geometry.spheres import BallsOnBalls, BallsOnPlane
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.errors import ModelError

_ROUND = (Sphere, Points)
_WITH_FACES = (Box, Capsule, Cylinder, Mesh)
_OF_BALLS = (*_ROUND, Box, Capsule, Mesh)  # where they meet a plane


def contact_pair(robot: Robot, between: Between, margin: float = 0.0) -> ContactPair:
    """The features of two bodies.

    Args:
        robot: The robot.
        between: Both bodies.
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


def _reach(robot: Robot, met: Sequence[Met]) -> float:
    """How far points that may touch are from the moving point of the first pair [m]."""
    if any(one.is_back is not met[0].is_back for one in met):
        return math.inf
    at = [robot.places.points[one.meeting.pair.b.number].at.translation for one in met]
    ways = [float(np.linalg.norm(point - at[0])) for point in at]
    return max(way + one.meeting.reach for way, one in zip(ways, met, strict=True))


def _has_plane(side: Side) -> bool:
    return any(isinstance(shape, HalfSpace) for shape in side.shapes)


def _items(robot: Robot, side: Side, round_: tuple[type, ...]) -> list[tuple[str, Any]]:
    """All balls of a side together, and its other shapes, each with what features end with."""
    balls = [i for i, shape in enumerate(side.shapes) if isinstance(shape, round_)]
    items: list[tuple[str, Any]] = [("", balls_of(robot, side, balls))] if balls else []
    rest = ((i, shape) for i, shape in enumerate(side.shapes) if i not in balls)
    return [*items, *((suffix(side, i), shape) for i, shape in rest)]


def _tell_apart(between: Between, a: list[str], b: list[str], met: list[Met]) -> None:
    """Give features of several shapes names of their own."""
    ends = [f"{one}{other.replace('_of_', '_on_')}" for one in a for other in b]
    for (meeting, _), end in zip(met, ends, strict=True):
        meeting.features = tuple(f"{name}{end}" for name in meeting.features)


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
        from mbd_ros.core.geometry.cylinder import CylinderOnPlane

        return CylinderOnPlane(robot.pair(resting.at, moving.at), moving)
    if isinstance(moving, Box) and isinstance(resting, Box):
        from mbd_ros.core.geometry.boxes import BoxOnBox

        return BoxOnBox(robot.pair(resting.at, moving.at), moving.sides, resting.sides)
    if isinstance(moving, _WITH_FACES) and isinstance(resting, _WITH_FACES):
        from mbd_ros.core.geometry.convex import ConvexOnConvex

        pair = robot.pair(resting.at, moving.at)
        return ConvexOnConvex(pair, _faces_of(moving), _faces_of(resting))
    return None


def _faces_of(shape: Box | Capsule | Cylinder | Mesh) -> Polyhedron:
    if isinstance(shape, Mesh):
        return shape.body
    if isinstance(shape, Box):
        return box_of(shape.sides)
    if isinstance(shape, Capsule):
        return line_of(shape.radius, shape.length)
    return prism_of(shape.radius, shape.length)


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
        from mbd_ros.core.geometry.solids import BallsOnSolid

        return BallsOnSolid(pair, balls, resting)
    return None
