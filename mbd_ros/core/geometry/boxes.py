"""A box on a box: vertices of both, and crossings of edges of the faces that face each other.

The separating axis with the largest gap says which face of each box that is. Source: S.
Gottschalk, M. Lin, D. Manocha, OBBTree, SIGGRAPH 1996, for the axes; the corners of the region
that two faces share are vertices of one face over the other, or crossings of their edges.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.geometry.feature_gaps import (
    Meeting,
    Touch,
    framed,
    nearest_bases,
)
from mbd_ros.core.geometry.shapes import CORNERS
from mbd_ros.core.geometry.simple_bodies import BESIDE
from mbd_ros.core.kinematics.poses import cross, dot, lengths
from mbd_ros.core.kinematics.relative_motion import PairMotion
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array

_ACROSS = 0.1  # sine of the angle of two edges from which their crossing has a normal of its own
_OTHERS = ((1, 2), (2, 0), (0, 1))  # axes of a face
_EDGES = np.array(((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)))  # along which, on which side


class BoxOnBox(Meeting):
    """A moving box a over a resting box b.

    Features are `a_0` to `a_7` and `b_0` to `b_7`, the vertices, and `edge_0_in` to `edge_3_out`:
    where an edge of the face of a enters and leaves the outline of the face of b. What coincides
    is one feature: vertices of a come before those of b, and both before crossings.

    Args:
        pair: Centre of b, as the observer, and that of a.
        sides_a: Lengths of the edges of a [m], shape (3,).
    """

    why_not = "features of boxes come and go as they slide over edges"

    def __init__(self, pair: Pair, sides_a: Array, sides_b: Array) -> None:
        vertices = [f"{side}_{i}" for side in "ab" for i in range(len(CORNERS))]
        edges = [f"edge_{i}_{end}" for i in range(len(_EDGES)) for end in ("in", "out")]
        super().__init__(pair, (*vertices, *edges))
        self._a = sides_a / 2.0
        self._b = sides_b / 2.0
        self.reach = float(np.linalg.norm(self._a))
        self._size = float(max(self._a.max(), self._b.max()))
        self._beside = BESIDE * float(min(self._a.min(), self._b.min()))

    def touch(self, pose: Any) -> Touch:
        """Vertices and crossings at the faces that face each other."""
        R, o = pose.rotation, pose.translation
        faces = self.faces(R.real, o.real)
        parts = (
            self._vertices_of_a(R, o, faces),
            self._vertices_of_b(R, o, faces),
            self._crossings(R, o, faces),
        )
        gap, point, normal = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Touch(gap, point - o, framed(normal, nearest_bases(normal)))

    def clearance(self, seen: PairMotion, gaps: Array) -> float:
        """Return a lower bound of the distance of the bodies [m], which features may exceed."""
        pose = seen.pose()
        return min(self.faces(pose.rotation, pose.translation).apart, float(gaps.min()))

    def faces(self, R: Array, o: Array) -> Faces:
        """The faces that face each other.

        Args:
            R: Rotation of a in the axes of b, shape (3, 3).
            o: Its centre [m], shape (3,).
        """
        size, seen = np.abs(R), o.dot(R)
        apart_b = np.abs(o) - self._b - size.dot(self._a)
        apart_a = np.abs(seen) - self._a - self._b.dot(size)
        b, a = int(np.argmax(apart_b)), int(np.argmax(apart_a))
        if apart_b[b] >= apart_a[a] - self._beside:
            best, normal = apart_b[b], np.copysign(np.eye(3)[b], o[b])
        else:
            best, normal = apart_a[a], R[:, a] * np.copysign(1.0, seen[a])
        axes = cross(np.eye(3)[:, None], R.T[None]).reshape(-1, 3)
        length = lengths(axes)
        axes = axes[length > _ACROSS] / length[length > _ACROSS, None]
        if len(axes):
            along = axes.dot(o)
            apart = np.abs(along) - np.abs(axes).dot(self._b) - np.abs(axes.dot(R)).dot(self._a)
            edge = int(np.argmax(apart))
            if apart[edge] > best + self._beside:
                best, normal = apart[edge], axes[edge] * np.copysign(1.0, along[edge])
        seen = normal.dot(R)
        a, b = int(np.argmax(np.abs(seen))), int(np.argmax(np.abs(normal)))
        sign_a, sign_b = -float(np.copysign(1.0, seen[a])), float(np.copysign(1.0, normal[b]))
        return Faces(a, sign_a, b, sign_b, normal, float(best))

    def _vertices_of_a(self, R: Array, o: Array, faces: Faces) -> tuple[Array, Array, Array]:
        point = (CORNERS * self._a).dot(R.T) + o
        gap, inside, _ = _over(point, self._b, faces.axis_b, faces.sign_b)
        gap = np.where(inside.real >= -self._beside, gap, _away(gap, inside))
        normal = np.zeros((len(point), 3), dtype=point.dtype)
        normal[:, faces.axis_b] = faces.sign_b
        return gap, point, normal

    def _vertices_of_b(self, R: Array, o: Array, faces: Faces) -> tuple[Array, Array, Array]:
        point = CORNERS * self._b
        gap, inside, corner = _over((point - o).dot(R), self._a, faces.axis_a, faces.sign_a)
        is_own = (inside.real >= -self._beside) & (corner > self._beside)
        gap = np.where(is_own, gap, _away(gap, inside) + self._size)
        normal = np.repeat(-faces.sign_a * R[:, faces.axis_a][None], len(point), axis=0)
        return gap, point.astype(R.dtype), normal

    def _crossings(self, R: Array, o: Array, faces: Faces) -> tuple[Array, Array, Array]:
        start, along = self._edges_of_a(R, o, faces)
        share, side = _clipped(start, along, self._b, faces.axis_b)
        start, along = np.repeat(start, 2, axis=0), np.repeat(along, 2, axis=0)
        rows, others = np.arange(len(share)), np.array(_OTHERS[faces.axis_b])
        edge = np.zeros_like(start.real)  # direction of the edge of b, and a point of it
        edge[rows, others[1 - side]] = 1.0
        corner = np.zeros_like(edge)
        corner[:, faces.axis_b] = faces.sign_b * self._b[faces.axis_b]
        reached = start + share[:, None] * along
        at = others[side]
        corner[rows, at] = np.copysign(self._b[at], reached[rows, at].real)
        across = cross(along, edge)
        length, edge_length = lengths(across), lengths(along)
        skew = length.real > _ACROSS * edge_length.real
        safe = np.where(skew, length, 1.0)[:, None]
        own = across / safe * np.where(across.real.dot(faces.normal) < 0.0, -1.0, 1.0)[:, None]
        normal = np.where(skew[:, None], own, faces.normal)
        level = cross(edge, across)
        exact = dot(corner - start, level) / np.where(skew, length**2, 1.0)
        share = np.where(skew, exact, share)
        point = start + share[:, None] * along
        beyond = point - np.where(edge > 0.0, point, corner)
        gap = dot(beyond, normal)
        on_b = self._b[others[1 - side]] - np.abs(point[rows, others[1 - side]].real)
        on_a = np.minimum(share.real, 1.0 - share.real) * edge_length.real
        is_inside = np.minimum(np.minimum(on_a, on_b), length.real) > self._beside
        return np.where(is_inside, gap, self._size + np.abs(gap.real)), point, normal

    def _edges_of_a(self, R: Array, o: Array, faces: Faces) -> tuple[Array, Array]:
        """Where the edges of the face of a begin, and where they lead, shape (4, 3) each."""
        first, second = _OTHERS[faces.axis_a]
        start, along = np.zeros((len(_EDGES), 3)), np.zeros((len(_EDGES), 3))
        start[:, faces.axis_a] = faces.sign_a * self._a[faces.axis_a]
        for i, (way, side) in enumerate(_EDGES.tolist()):
            mine, other = (first, second) if way == 0 else (second, first)
            start[i, mine], start[i, other] = -self._a[mine], side * self._a[other]
            along[i, mine] = 2.0 * self._a[mine]
        return start.dot(R.T) + o, along.dot(R.T)


def _over(point: Array, half: Array, axis: int, sign: float) -> tuple[Array, Array, Array]:
    """Heights over a face, how far inside its outline, how far from its corners, shape (n,) each.

    Args:
        point: In the axes of the box, shape (n, 3).
        half: Half the sides of the box.
        axis: Of the face.
        sign: On which side of the box it is.
    """
    others = list(_OTHERS[axis])
    aside = half[others] - np.where(point[:, others].real < 0.0, -1.0, 1.0) * point[:, others]
    first = aside[:, 0].real < aside[:, 1].real
    inside: Array = np.where(first, aside[:, 0], aside[:, 1])
    beside = np.where(inside.real < 0.0, -inside, 0.0)
    corner = np.abs(aside.real).max(axis=1)
    return sign * point[:, axis] - half[axis] + beside, inside, corner


def _away(gap: Array, inside: Array) -> Array:
    """Gaps of what is beside a face: never negative."""
    away: Array = np.maximum(gap.real, 0.0) + np.abs(inside.real)
    return away


def _clipped(start: Array, along: Array, half: Array, axis: int) -> tuple[Array, Array]:
    """Where lines enter and leave the outline of a face, seen along its normal.

    Source: Y.-D. Liang, B. Barsky, A new concept and method for line clipping, 1984.

    Returns:
        Share of the line in turns of entering and leaving, and which of both axes of the face
        it passes there, shape (2 n,) each.
    """
    others = list(_OTHERS[axis])
    p, d, h = start[:, others], along[:, others], half[others]
    way = np.where(d.real < 0.0, -1.0, 1.0)
    is_along = np.abs(d.real) <= 1e-12 * h
    slope = np.where(is_along, 1.0, d)
    enter = np.where(is_along, -1.0e9, (-way * h - p) / slope)
    leave = np.where(is_along, 1.0e9, (way * h - p) / slope)
    first, last = np.argmax(enter.real, axis=1), np.argmin(leave.real, axis=1)
    rows = np.arange(len(start))
    share = np.stack((enter[rows, first], leave[rows, last]), axis=1)
    missed = (share[:, 0].real >= share[:, 1].real)[:, None]
    share = np.where(missed, -1.0e3, share)
    return share.ravel(), np.stack((first, last), axis=1).ravel()


class Faces(NamedTuple):
    """Which faces of two boxes face each other.

    Attributes:
        axis_a: Of the face of the moving box.
        sign_a: 1 or -1, on which side of it.
        axis_b: Of the face of the resting one.
        sign_b: 1 or -1.
        normal: Separating direction out of the resting box, shape (3,).
        apart: Distance along it, negative where the boxes overlap [m].
    """

    axis_a: int
    sign_a: float
    axis_b: int
    sign_b: float
    normal: Array
    apart: float
