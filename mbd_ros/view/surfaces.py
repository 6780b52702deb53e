"""Triangles of simple bodies; lengths in metres, vertices as float32."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

_AROUND, _UPWARDS = 24, 12  # edges of a circle, and from pole to pole of a sphere
_WAIST = 0.2  # where a bone is thickest, as a share of its length
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


class Surface(NamedTuple):
    """A surface of triangles.

    Attributes:
        vertices: [m], shape (n, 3), float32.
        triangles: Three vertices each, counter-clockwise from outside, shape (m, 3), uint32.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]


def box(size: Sequence[float]) -> Surface:
    """A box about the origin, of sizes along x, y and z [m]."""
    halves = [t for a, b, c, d in _FACES for t in ((a, b, c), (a, c, d))]
    return _surface(_CORNERS * np.asarray(size) / 2.0, np.array(halves))


def sphere(radius: float) -> Surface:
    """A sphere about the origin."""
    angles = np.linspace(-math.pi / 2.0, math.pi / 2.0, _UPWARDS + 1)
    return lathe(radius * np.cos(angles), radius * np.sin(angles))


def cylinder(radius: float, length: float) -> Surface:
    """A cylinder about the origin, along z."""
    half = length / 2.0
    return lathe([0.0, radius, radius, 0.0], [-half, -half, half, half])


def capsule(radius: float, length: float) -> Surface:
    """A cylinder along z, of that length, with half a sphere on each end."""
    angles = np.linspace(0.0, math.pi / 2.0, _UPWARDS // 2 + 1)
    out, up = radius * np.cos(angles), radius * np.sin(angles) + length / 2.0
    return lathe(np.concatenate((out[::-1], out)), np.concatenate((-up[::-1], up)))


def bone(end: Array, thickness: float = 0.12) -> Surface:
    """An octahedron from the origin to a point [m], thickest near the origin.

    Args:
        end: The point, shape (3,), not the origin.
        thickness: Half of its sides, as a share of its length.
    """
    length = float(np.linalg.norm(end))
    along = end / length
    across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    across /= np.linalg.norm(across)
    sides = np.array([across, np.cross(along, across)]) * thickness * length
    waist = end * _WAIST
    ring = [waist + sides[0], waist + sides[1], waist - sides[0], waist - sides[1]]
    around = [(i, (i + 1) % 4) for i in range(4)]
    triangles = [(0, 1 + b, 1 + a) for a, b in around] + [(5, 1 + a, 1 + b) for a, b in around]
    return _surface(np.array([np.zeros(3), *ring, end]), np.array(triangles))


def lathe(out: Sequence[float] | Array, up: Sequence[float] | Array) -> Surface:
    """A profile turned about z.

    Args:
        out: Distances from the axis [m], from the lowest point to the highest, shape (n,).
        up: Heights [m], shape (n,).
    """
    turn = np.arange(_AROUND) * (2.0 * math.pi / _AROUND)
    circle = np.column_stack((np.cos(turn), np.sin(turn), np.zeros(_AROUND)))
    rings = [r * circle + (0.0, 0.0, z) for r, z in zip(out, up, strict=True)]
    here = np.arange(_AROUND)
    following = (here + 1) % _AROUND
    triangles = []
    for i in range(len(rings) - 1):
        a, b = here + i * _AROUND, following + i * _AROUND
        c, d = a + _AROUND, b + _AROUND
        triangles += [np.column_stack((a, b, d)), np.column_stack((a, d, c))]
    return _surface(np.concatenate(rings), np.concatenate(triangles))


def _surface(vertices: Array, triangles: NDArray[np.intp]) -> Surface:
    return Surface(vertices.astype(np.float32), triangles.astype(np.uint32))
