"""Convex bodies with flat faces: vertices, faces and their planes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.vectors import cross, lengths
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError

CORNERS = np.array(
    [[1.0 if i >> axis & 1 else -1.0 for axis in range(3)] for i in range(8)]
)  # of a cube
_FLAT = 1.0e-5  # of the size: what triangles of one face may differ; files hold six digits
_SIDES = 24  # of the prism that stands for a cylinder


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
    faces, kept = list[NDArray[np.intp]](), list[int]()
    for i, normal in enumerate(normals):
        on = np.flatnonzero(heights[:, i] >= offsets[i] - 2.0 * _FLAT * size)
        if len(on) >= 3:
            faces.append(_ordered(vertices, on, normal))
            kept.append(i)
    return Polyhedron(vertices, normals[kept], offsets[kept], tuple(faces))


def _ordered(vertices: Array, on: NDArray[np.intp], normal: Array) -> NDArray[np.intp]:
    points = vertices[on] - vertices[on].mean(axis=0)
    x = points[int(np.argmax(lengths(points)))]
    angle = np.arctan2(points @ np.cross(normal, x), points @ x * float(np.linalg.norm(normal)))
    return on[np.argsort(angle)]


def box_of(sides: Array) -> Polyhedron:
    """A box, centred."""
    return hull_of(CORNERS * sides / 2.0, np.concatenate((np.eye(3), -np.eye(3))))


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
