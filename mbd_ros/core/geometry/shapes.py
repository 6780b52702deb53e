"""Shapes on links, which contacts are made of: as scenes name them, and as balls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.poses import cross, lengths
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError

CORNERS = np.array(
    [[1.0 if i >> axis & 1 else -1.0 for axis in range(3)] for i in range(8)]
)  # of a cube
_FLAT = 1.0e-5  # of the size: what triangles of one face may differ; files hold six digits
_SIDES = 24  # of the prism that stands for a cylinder


class Sphere(NamedTuple):
    """A ball about a point.

    Attributes:
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
        sides: Lengths of its edges [m], shape (3,).
    """

    at: Point
    sides: Array


class Capsule(NamedTuple):
    """All that is nearer to a line along z than a radius.

    Attributes:
        radius: [m].
        length: Of the line [m], without the half spheres at its ends.
    """

    at: Point
    radius: float
    length: float


class Cylinder(NamedTuple):
    """A cylinder along z.

    Attributes:
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


class Polyhedron(NamedTuple):
    """A convex body.

    Attributes:
        vertices: [m], shape (n, 3).
        normals: Of its faces, outward, shape (m, 3).
        offsets: normal . p of the points p of a face [m], shape (m,).
        faces: Vertices of each face, in order around its normal.
        radius: How far the surface is outside of the faces, 0 but for capsules [m].
    """

    vertices: Array
    normals: Array
    offsets: Array
    faces: tuple[NDArray[np.intp], ...]
    radius: float = 0.0

    @property
    def size(self) -> float:
        """Half the diagonal of its bounding box, and the radius [m]."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0))) / 2.0 + self.radius

    def facing(self, direction: Array) -> tuple[NDArray[np.intp], Array, float]:
        """The face that looks most along a direction: its vertices, normal and offset.

        A capsule has its line in place of one, with the normal that is nearest.
        """
        if self.faces:
            face = int(np.argmax(self.normals @ direction))
            return self.faces[face], self.normals[face], float(self.offsets[face])
        first, last = self.vertices
        axis = (last - first) / np.linalg.norm(last - first)
        across = direction - axis * axis.dot(direction)
        normal = across / max(float(np.linalg.norm(across)), TINY)
        return np.arange(2), normal, float(normal.dot(first))


def polyhedron(vertices: Array, triangles: NDArray[np.intp]) -> Polyhedron:
    """The body that triangles enclose.

    Args:
        vertices: [m], shape (n, 3); some may coincide.
        triangles: Indices of vertices, shape (t, 3), in either order.

    Raises:
        ModelError: The surface is not convex, or encloses nothing; says by how much.
    """
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    corners = vertices[triangles]
    normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = lengths(normals)
    real = area > _FLAT**2 * size**2
    if not real.any():
        raise ModelError("the mesh has no area")
    normals, corners = normals[real] / area[real, None], corners[real, 0]
    vertices = _distinct(vertices, _FLAT * size)
    heights = (vertices @ normals.T - np.einsum("ij,ij->i", normals, corners)).T
    below, above = -heights.min(axis=1), heights.max(axis=1)
    flipped = above > below
    normals = np.where(flipped[:, None], -normals, normals)
    beyond = float(np.minimum(below, above).max())
    if beyond > _FLAT * size:
        raise ModelError(f"the mesh is not convex: it is bent inwards by {beyond:.3g} m")
    if float(np.maximum(below, above).max()) <= _FLAT * size:
        raise ModelError("the mesh is flat, it encloses nothing")
    return hull_of(vertices, _distinct(normals, 10.0 * _FLAT))


def _distinct(rows: Array, tolerance: float) -> Array:
    """Rows that differ by more than a tolerance."""
    _, first = np.unique(np.round(rows / tolerance), axis=0, return_index=True)
    return rows[np.sort(first)]


def hull_of(vertices: Array, normals: Array) -> Polyhedron:
    """The body with some vertices and faces across some normals."""
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    heights = vertices @ normals.T
    offsets = heights.max(axis=0)
    faces, chosen = list[NDArray[np.intp]](), list[int]()
    for i, normal in enumerate(normals):
        on = np.flatnonzero(heights[:, i] >= offsets[i] - 2.0 * _FLAT * size)
        if len(on) >= 3:
            faces.append(_ordered(vertices, on, normal))
            chosen.append(i)
    return Polyhedron(vertices, normals[chosen], offsets[chosen], tuple(faces))


def _ordered(vertices: Array, on: NDArray[np.intp], normal: Array) -> NDArray[np.intp]:
    points = vertices[on] - vertices[on].mean(axis=0)
    x = points[int(np.argmax(lengths(points)))]
    angle = np.arctan2(points @ np.cross(normal, x), points @ x * float(np.linalg.norm(normal)))
    return on[np.argsort(angle)]


def line_of(radius: float, length: float) -> Polyhedron:
    """A capsule along z: its line, and how far it is from the surface."""
    ends = np.zeros((2, 3))
    ends[:, 2] = -length / 2.0, length / 2.0
    return Polyhedron(ends, np.zeros((0, 3)), np.zeros(0), (), radius)


def prism_of(radius: float, length: float) -> Polyhedron:
    """A prism along z for a cylinder: its edges are on the cylinder, its sides inside."""
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    middle = angles + np.pi / _SIDES
    round_ = np.column_stack((np.cos(angles), np.sin(angles))) * radius
    ends = [np.column_stack((round_, np.full(_SIDES, z))) for z in (-length / 2.0, length / 2.0)]
    sides = np.column_stack((np.cos(middle), np.sin(middle), np.zeros(_SIDES)))
    caps = np.array(((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)))
    return hull_of(np.concatenate(ends), np.concatenate((caps, sides)))


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


class Side(NamedTuple):
    """The shapes of one of the two bodies of a contact.

    Attributes:
        frame: The link, or another frame of it.
    """

    frame: str
    shapes: tuple[Shape, ...]


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
    """Return the prefix that tells features of one shape of a side from those of the others."""
    return f"_of_{number}" if len(side.shapes) > 1 else ""


def box_of(sides: Array) -> Polyhedron:
    """A box, centred."""
    return hull_of(CORNERS * sides / 2.0, np.concatenate((np.eye(3), -np.eye(3))))


class Between(NamedTuple):
    """The two bodies of a contact.

    Attributes:
        a: The first one, on which multipliers push.
        b: The other one, whose normal points out of it.
    """

    a: Side
    b: Side
