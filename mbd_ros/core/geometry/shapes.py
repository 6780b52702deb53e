"""Shapes on links, which contacts are made of: as scenes name them, and as balls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.geometry.polyhedron import CORNERS, Polyhedron
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array


class Sphere(NamedTuple):
    """A ball about a point.

    Attributes:
        at: Its centre.
        radius: [m], 0 for a point.
    """

    at: Point
    radius: float


class Points(NamedTuple):
    """Points of a link.

    Attributes:
        at: Whose axes they stand in.
        points: [m], shape (n, 3).
    """

    at: Point
    points: Array


class Box(NamedTuple):
    """A box along the axes of a point.

    Attributes:
        at: Its centre.
        sides: Lengths of its edges [m], shape (3,).
    """

    at: Point
    sides: Array


class Capsule(NamedTuple):
    """All that is nearer to a line along z than a radius.

    Attributes:
        at: Its centre.
        radius: [m].
        length: Of the line [m], without the half spheres at its ends.
    """

    at: Point
    radius: float
    length: float


class Cylinder(NamedTuple):
    """A cylinder along z.

    Attributes:
        at: Its centre.
        radius: [m].
        length: [m].
    """

    at: Point
    radius: float
    length: float


class HalfSpace(NamedTuple):
    """All that is below the plane z = 0.

    Attributes:
        at: A point of the plane, z the outward normal.
    """

    at: Point


class Mesh(NamedTuple):
    """A convex body with flat faces.

    Attributes:
        at: In whose axes it stands.
        body: Vertices and faces.
    """

    at: Point
    body: Polyhedron


Shape = Sphere | Points | Box | Capsule | Cylinder | HalfSpace | Mesh


class Side(NamedTuple):
    """What one of two bodies brings to a contact.

    Attributes:
        frame: The link, or another frame of it.
        shapes: Its shapes.
    """

    frame: str
    shapes: tuple[Shape, ...]


class Between(NamedTuple):
    """The two bodies of a contact.

    Attributes:
        a: The first one, on which multipliers push.
        b: The other one, whose normal points out of it.
    """

    a: Side
    b: Side


def balls_of(robot: Robot, side: Side, numbers: Sequence[int]) -> Balls:
    """The balls that some shapes of a side are, all of them, or where they meet a plane.

    Vertex i of a box stands at +x where bit 0 of i is set, at +y for bit 1 and at +z for bit 2.

    Args:
        side: One of both bodies.
        numbers: Which of its shapes: spheres, points, boxes, capsules and meshes.
    """
    names, places, radii = list[str](), list[Array](), list[float]()
    for i in numbers:
        shape = side.shapes[i]
        titles, centres, radius = _parts(shape)
        at = robot.places.points[shape.at.number].at
        names += [f"{title}{suffix(side, i)}" for title in titles]
        places += [at.act(centre) for centre in centres]
        radii += [radius] * len(titles)
    centres = np.array(places)
    middle = centres.mean(axis=0)
    at = robot.shifted(robot.carrier(side.frame), middle)
    return Balls(tuple(names), at, centres - middle, np.array(radii))


def _parts(shape: Shape) -> tuple[list[str], Array, float]:
    """Names, centres in the axes of the shape and radius of its balls."""
    if isinstance(shape, Sphere):
        return ["sphere"], np.zeros((1, 3)), shape.radius
    if isinstance(shape, Points):
        return [f"point_{i}" for i in range(len(shape.points))], shape.points, 0.0
    if isinstance(shape, Capsule):
        ends = np.zeros((2, 3))
        ends[:, 2] = -shape.length / 2.0, shape.length / 2.0
        return ["end_0", "end_1"], ends, shape.radius
    if isinstance(shape, Box):
        return [f"vertex_{i}" for i in range(8)], CORNERS * shape.sides / 2.0, 0.0
    if isinstance(shape, Mesh):
        vertices = shape.body.vertices
        return [f"vertex_{i}" for i in range(len(vertices))], vertices, 0.0
    raise TypeError(type(shape).__name__)


def suffix(side: Side, number: int) -> str:
    """What tells features of one shape of a side from those of the others."""
    return f"_of_{number}" if len(side.shapes) > 1 else ""


class Balls(NamedTuple):
    """Balls on one body.

    Attributes:
        names: One a ball.
        at: Middle of their centres, with axes that turn with the body.
        centres: From there, in these axes [m], shape (n, 3).
        radii: [m], shape (n,).
    """

    names: tuple[str, ...]
    at: Point
    centres: Array
    radii: Array

    @property
    def reach(self) -> float:
        """How far their points are from `at` at most [m]."""
        return float((np.linalg.norm(self.centres, axis=1) + self.radii).max())
