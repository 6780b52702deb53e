"""Outlines of two faces that face each other, and what they share."""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.geometry.frames import crossed, dotted, framed, lengths, nearest_bases
from mbd_ros.core.state import Array

STRAIGHT = 1.0e-9  # sine of the angle of lines that do not cross
_ACROSS = 0.1  # sine of the angle of two edges from which their crossing has a normal of its own
_CORNERS = np.array(((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)))


def inside(points: Array, outline: Array, up: Array, beside: float) -> NDArray[np.bool_]:
    """Which points are inside an outline, seen along a direction, or so far beside it."""
    along = np.roll(outline, -1, axis=0) - outline
    inward = crossed(up, along.real)
    length = lengths(inward)
    some = length > 0.0
    if not some.any():  # so far away that its corners are one
        return np.zeros(len(points), dtype=bool)
    inward = inward[some] / length[some, None]
    depth = points.real @ inward.T - dotted(outline.real[some], inward)
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
    across = crossed(along[:, None], edge[None]) @ up
    long, wide = lengths(along.real)[:, None], lengths(edge.real)[None]
    is_crossing = np.abs(across.real) > np.maximum(STRAIGHT * long, beside) * wide
    safe = np.where(is_crossing, across, 1.0)
    own = (crossed(offset, edge[None]) @ up) / safe
    other = (crossed(offset, along[:, None]) @ up) / safe
    is_crossing &= np.minimum(own.real, 1.0 - own.real) * long > beside
    is_crossing &= np.minimum(other.real, 1.0 - other.real) * wide > beside
    first, second = np.nonzero(is_crossing)
    along, edge, start, end = along[first], edge[second], outline[first], base[second]
    cross = crossed(along, edge)
    length = lengths(cross)
    is_skew = length.real > _ACROSS * long[first, 0] * wide[0, second]
    some = np.where(is_skew, length, 1.0)
    sign = np.where(cross.real @ normal < 0.0, -1.0, 1.0)
    normals = np.where(is_skew[:, None], cross * (sign / some)[:, None], normal)
    exact = dotted(end - start, crossed(edge, cross)) / some**2
    points = start + np.where(is_skew, exact, own[first, second])[:, None] * along
    below = np.where(is_skew[:, None], end, end + other[first, second][:, None] * edge)
    return dotted(points - below, normals), points, normals


def _edges(ring: Array) -> tuple[Array, Array]:
    """Where edges begin, and where they lead; two points have one."""
    starts = ring[:1] if len(ring) == 2 else ring
    return starts, np.roll(ring, -1, axis=0)[: len(starts)] - starts


def extremes(corners: Array, up: Array) -> NDArray[np.intp]:
    """What is farthest along the four directions between the tangents."""
    tangents = nearest_bases(up[None])[0]
    tangents = framed(up[None], tangents)[0, 1:]
    flat = corners.real @ tangents.T @ _CORNERS.T
    return np.argmax(flat, axis=0)
