"""A convex body with flat faces on another one: the region that two faces share.

The separating direction is that of a face, or what coal says of bodies that are moved a little
apart, where edges cross. Of the region that the faces share four corners and the nearest point
are features. Source of coal's search: E. Gilbert, D. Johnson, S. Keerthi, A fast procedure for
computing the distance between complex objects, IEEE J. Robot. Autom. 4, 1988.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.geometry.feature_gaps import (
    Meeting,
    Touch,
    framed,
    nearest_bases,
)
from mbd_ros.core.geometry.shapes import Polyhedron
from mbd_ros.core.geometry.simple_bodies import BESIDE
from mbd_ros.core.kinematics.poses import cross, dot, lengths
from mbd_ros.core.kinematics.relative_motion import PairMotion
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array

STRAIGHT = 1.0e-9  # sine of the angle of lines that do not cross
_ACROSS = 0.1  # sine of the angle of two edges from which their crossing has a normal of its own
_CORNERS = np.array(((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)))
_LOOKS = 2  # of coal's search: as the bodies are, and a little farther apart
_APART = 0.01  # of the smaller size: how far bodies are apart while coal looks at them
_PARALLEL = 0.9  # cosine of the angle of faces that may share a region
_SEARCHED = 1.0e-12  # where coal's search ends
_SEEN = 1.0e-5  # of the smaller size: by how much the ends of an edge may be apart along a normal


class ConvexOnConvex(Meeting):
    """A moving polyhedron a over a resting one b.

    Features are `nearest`, where a is nearest to the face of b or where two edges cross, and
    `corner_0` to `corner_3`: of the region that the faces share what is farthest along x + y,
    -x + y, -x - y and x - y of the contact frame.

    Args:
        pair: Axes of b, as the observer, and those of a.
        a: The moving body.
        b: The resting one.
    """

    why_not = "features of bodies with faces come and go as they slide over edges"

    def __init__(self, pair: Pair, a: Polyhedron, b: Polyhedron) -> None:
        super().__init__(pair, ("nearest", *(f"corner_{i}" for i in range(4))))
        self._a = a
        self._b = b
        self.reach = float(lengths(a.vertices).max()) + a.radius
        self._round = a.radius + b.radius
        self._size = min(a.size, b.size)
        self._beside = BESIDE * self._size
        self._shapes = (_hull(a), _hull(b))
        self._request = coal.DistanceRequest()
        self._request.gjk_tolerance = _SEARCHED

    def clearance(self, seen: PairMotion, gaps: Array) -> float:
        """Return a lower bound of the distance of the bodies [m], which features may exceed."""
        pose = seen.pose()
        return min(self._apart(pose.rotation, pose.translation).distance, float(gaps.min()))

    def touch(self, pose: Any) -> Touch:
        """The nearest points and the corners of the shared region."""
        R, o = pose.rotation, pose.translation
        apart = self._apart(R.real, o.real)
        far = max(apart.distance, 0.0) + self._size
        vertices = self._a.vertices @ R.T + o
        gap, point, normal = self._nearest(R, o, vertices, apart)
        gap = gap - self._round
        gaps = np.full(len(self.features), far, dtype=R.dtype)
        points, normals = (np.repeat(one[None], len(gaps), axis=0) for one in (point, normal))
        corners = self._shared(R, o, vertices, apart)
        least = apart.distance - 0.5 * abs(apart.distance) - self._beside
        valid = np.flatnonzero(corners.gap.real >= least)
        if len(valid):
            chosen = valid[extremes(corners.point[valid], apart.normal)]
            points[1:], normals[1:] = corners.point[chosen], corners.normal[chosen]
            _, first = np.unique(chosen, return_index=True)
            gaps[1 + first] = corners.gap[chosen[first]]
        if gaps.real.min() > apart.distance + self._beside:
            gaps[0] = gap
        points = points - self._a.radius * normals
        return Touch(gaps, points - o, framed(normals, nearest_bases(normals)))

    def _apart(self, R: Array, o: Array) -> Apart:
        a, b = self._a, self._b
        vertices = a.vertices @ R.T + o
        over_b = (vertices @ b.normals.T).min(axis=0) - b.offsets
        over_a = (((b.vertices - o) @ R) @ a.normals.T).min(axis=0) - a.offsets
        normal, best = np.zeros(3), -np.inf
        on: tuple[int | None, int | None] = (None, None)
        if len(over_b):
            i = int(np.argmax(over_b))
            normal, best, on = b.normals[i], float(over_b[i]), (None, i)
        if len(over_a) and over_a.max() > best + self._beside:
            j = int(np.argmax(over_a))
            normal, best, on = -R @ a.normals[j], float(over_a[j]), (j, None)
        for between in self._seen_by_coal(R, o):
            own = float((vertices @ between).min() - (b.vertices @ between).max())
            if own > best + self._beside:
                normal, best, on = between, own, (None, None)
        return Apart(normal, best - self._round, *on)

    def _seen_by_coal(self, R: Array, o: Array) -> Iterator[Array]:
        """Directions out of b that part the bodies, as they are and a little farther apart."""
        away = np.zeros(3)
        for _ in range(_LOOKS):
            result, there = coal.DistanceResult(), coal.Transform3s(R, o + away)
            distance = coal.distance(
                self._shapes[0], there, self._shapes[1], coal.Transform3s(), self._request, result
            )
            normal = -np.asarray(result.normal)  # coal's is out of a
            if not np.isfinite(normal).all():
                return
            yield normal
            away = away + (_APART * self._size - distance) * normal

    def _shared(self, R: Array, o: Array, vertices: Array, apart: Apart) -> Corners:
        """Corners of the region that both faces share; none where they are not nearly parallel."""
        a, b = self._a, self._b
        ring_b, top, height = b.facing(apart.normal)
        ring_a, bottom, depth = a.facing(-apart.normal @ R.real)
        up, down = top.astype(R.dtype), R @ bottom
        if (up @ down).real > -_PARALLEL:
            return Corners(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
        outline, base = vertices[ring_a], b.vertices[ring_b]
        over, under = outline[:0], base[:0]  # a line has no inside
        if b.faces:
            over = outline[inside(outline, base, up.real, self._beside)]
        if a.faces:
            under = base[inside(base, outline, down.real, self._beside)]
        if len(over) and len(under):  # what coincides is a corner of a
            ways = lengths(cross(under.real[:, None] - over.real[None], up.real))
            under = under[ways.min(axis=1) > 2.0 * self._beside]
        crossing = crossings(outline, base, up.real, apart.normal, self._beside)
        faces = (
            (over @ up - height, over, np.tile(up, (len(over), 1))),
            ((under - o) @ down - depth, under, np.tile(-down, (len(under), 1))),
        )
        gap, point, normal = map(np.concatenate, zip(*faces, crossing, strict=True))
        return Corners(gap - self._round, point, normal)

    def _nearest(
        self, R: Array, o: Array, vertices: Array, apart: Apart
    ) -> tuple[Array, Array, Array]:
        """Gap, point on a and normal where one point of a body is nearest to the other."""
        a, b = self._a, self._b
        heights, depths = vertices.real @ apart.normal, b.vertices @ apart.normal
        point, base = vertices[int(np.argmin(heights))], b.vertices[int(np.argmax(depths))]
        normal = apart.normal.astype(R.dtype)
        if apart.face_b is not None:
            return point @ normal - b.offsets[apart.face_b], point, normal
        if apart.face_a is not None:
            normal = -R @ a.normals[apart.face_a]
            return (o - base) @ normal - a.offsets[apart.face_a], base.astype(R.dtype), normal
        seen = _SEEN * self._size
        ends_a = vertices[heights <= heights.min() + seen]
        ends_b = b.vertices[depths >= depths.max() - seen]
        if len(ends_a) == len(ends_b) == 2:
            crossing = _crossing(ends_a, ends_b, apart.normal)
            return crossing or ((point - base) @ normal, point, normal)
        if self._round and len(ends_a) + len(ends_b) <= 3:
            way, point = _way(ends_a, ends_b)
            gap = np.sqrt(dot(way, way))
            return gap, point, way / gap
        return (point - base) @ normal, point, normal


def _hull(body: Polyhedron) -> Any:
    """The body as coal takes it, each face as a fan of triangles."""
    if not body.faces:
        return coal.Capsule(0.0, float(np.ptp(body.vertices[:, 2])))
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in body.vertices:
        points.append(vertex)
    for face in body.faces:
        first, *rest = face.tolist()
        for second, third in itertools.pairwise(rest):
            triangles.append(coal.Triangle(first, second, third))
    return coal.Convex(points, triangles)


def extremes(corners: Array, up: Array) -> NDArray[np.intp]:
    """Return the farthest points along the four directions between the tangents."""
    tangents = nearest_bases(up[None])[0]
    tangents = framed(up[None], tangents)[0, 1:]
    flat = corners.real @ tangents.T @ _CORNERS.T
    return np.argmax(flat, axis=0)


def inside(points: Array, outline: Array, up: Array, beside: float) -> NDArray[np.bool_]:
    """Which points are inside an outline, seen along a direction, or so far beside it."""
    along = np.roll(outline, -1, axis=0) - outline
    inward = cross(up, along.real)
    length = lengths(inward)
    some = length > 0.0
    if not some.any():  # so far away that its corners are one
        return np.zeros(len(points), dtype=bool)
    inward = inward[some] / length[some, None]
    depth = points.real @ inward.T - dot(outline.real[some], inward)
    inside: NDArray[np.bool_] = depth.min(axis=1) >= -beside
    return inside


def crossings(
    outline: Array, base: Array, up: Array, normal: Array, beside: float
) -> tuple[Array, Array, Array]:
    """Where edges of one outline pass over those of another.

    Args:
        outline: Corners of the face of a, shape (m, 3).
        base: Those of the face of b.
        up: Normal of the face of b, shape (3,).
        normal: That of edges that are nearly parallel.
        beside: Shortest way from their ends [m].

    Returns:
        Gaps, points on a and normals, of n crossings.
    """
    (outline, along), (base, edge) = _edges(outline), _edges(base)
    offset = base[None] - outline[:, None]
    across = cross(along[:, None], edge[None]) @ up
    long, wide = lengths(along.real)[:, None], lengths(edge.real)[None]
    is_crossing = np.abs(across.real) > np.maximum(STRAIGHT * long, beside) * wide
    safe = np.where(is_crossing, across, 1.0)
    share_of_first = (cross(offset, edge[None]) @ up) / safe
    other = (cross(offset, along[:, None]) @ up) / safe
    is_crossing &= np.minimum(share_of_first.real, 1.0 - share_of_first.real) * long > beside
    is_crossing &= np.minimum(other.real, 1.0 - other.real) * wide > beside
    first, second = np.nonzero(is_crossing)
    along, edge, start, end = along[first], edge[second], outline[first], base[second]
    out = cross(along, edge)
    length = lengths(out)
    is_skew = length.real > _ACROSS * long[first, 0] * wide[0, second]
    some = np.where(is_skew, length, 1.0)
    sign = np.where(out.real @ normal < 0.0, -1.0, 1.0)
    normals = np.where(is_skew[:, None], out * (sign / some)[:, None], normal)
    exact = dot(end - start, cross(edge, out)) / some**2
    points = start + np.where(is_skew, exact, share_of_first[first, second])[:, None] * along
    below = np.where(is_skew[:, None], end, end + other[first, second][:, None] * edge)
    return dot(points - below, normals), points, normals


def _edges(ring: Array) -> tuple[Array, Array]:
    """Where edges begin, and where they lead; two points have one."""
    starts = ring[:1] if len(ring) == 2 else ring
    return starts, np.roll(ring, -1, axis=0)[: len(starts)] - starts


def _crossing(a: Array, b: Array, out: Array) -> tuple[Array, Array, Array] | None:
    """Gap, point on a and normal of two lines that cross; None where they are parallel."""
    along, edge = a[1] - a[0], b[1] - b[0]
    across = cross(along, edge)
    square = dot(across, across)
    if square.real <= STRAIGHT**2 * dot(along, along).real * edge.dot(edge):
        return None
    normal = across / np.sqrt(square) * (1.0 if across.real @ out > 0.0 else -1.0)
    point = a[0] + dot(b[0] - a[0], cross(edge, across)) / square * along
    return (point - b[0]) @ normal, point, normal


def _way(a: Array, b: Array) -> tuple[Array, Array]:
    """From the nearest point of b to that of a, and this; one of both may be a line."""
    if len(a) > 1:
        along = a[1] - a[0]
        point = a[0] + dot(b[0] - a[0], along) / dot(along, along) * along
        return point - b[0], point
    way = a[0] - b[0]
    if len(b) > 1:
        along = b[1] - b[0]
        way = way - dot(way, along) / dot(along, along) * along
    return way, a[0]


class Apart(NamedTuple):
    """How two bodies are separated.

    Attributes:
        normal: Out of the resting body, shape (3,), real.
        distance: Along it, negative where they overlap [m].
        face_a: Face of the moving body that it is across, None where it is not.
        face_b: Face of the resting one.
    """

    normal: Array
    distance: float
    face_a: int | None
    face_b: int | None


class Corners(NamedTuple):
    """Corners of a region that two faces share.

    Attributes:
        gap: [m], shape (n,).
        point: [m], shape (n, 3).
        normal: Out of the resting body, shape (n, 3).
    """

    gap: Array
    point: Array
    normal: Array
