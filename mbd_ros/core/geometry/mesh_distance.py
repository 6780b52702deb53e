"""Signed distances of points to a convex body with flat faces."""

import numpy as np

from mbd_ros.core.geometry.frames import crossed, dotted, lengths
from mbd_ros.core.geometry.polyhedron import Polyhedron
from mbd_ros.core.state import Array


class ToMesh:
    """Signed distances to a polyhedron and outward normals.

    Args:
        body: The polyhedron.
        beside: How far beside a face a point still counts as on it [m].
    """

    def __init__(self, body: Polyhedron, beside: float) -> None:
        self._body, self._beside = body, beside
        rings = [body.vertices[face] for face in body.faces]
        self._starts = np.concatenate(rings)
        self._along = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
        self._squares = dotted(self._along, self._along)
        sizes = [len(ring) for ring in rings]
        self._first = np.cumsum([0, *sizes[:-1]])
        outward = crossed(self._along, np.repeat(body.normals, sizes, axis=0))
        self._outward = outward / lengths(outward)[:, None]
        self._edge_offsets = dotted(self._outward, self._starts)

    def __call__(self, centre: Array) -> tuple[Array, Array]:
        """Distances and normals of points in the axes of the body, shape (n, 3)."""
        body = self._body
        height = centre @ body.normals.T - body.offsets
        aside = np.maximum.reduceat(
            centre.real @ self._outward.T - self._edge_offsets, self._first, axis=1
        )
        over = aside <= self._beside
        rows, highest = np.arange(len(centre)), np.argmax(height.real, axis=1)
        is_inside = height.real[rows, highest] <= 0.0
        common = int(np.argmax(height.real.min(axis=0)))  # one face for all points over it
        is_near = is_inside | (height.real[:, common] >= -self._beside)
        face = np.where(over[:, common] & is_near, common, highest)
        gap, normal = height[rows, face], body.normals[face].astype(centre.dtype)
        on_face = is_inside | over[rows, face]
        if not on_face.all():
            far, away = self._to_edges(centre)
            gap = np.where(on_face, gap, far)
            normal = np.where(on_face[:, None], normal, away)
        return gap, normal

    def _to_edges(self, centre: Array) -> tuple[Array, Array]:
        """Distance to the nearest edge, and the direction from there."""
        offset = centre[:, None] - self._starts
        share = dotted(offset, self._along) / self._squares
        share = np.where(share.real < 0.0, 0.0, np.where(share.real > 1.0, 1.0, share))
        away = offset - share[:, :, None] * self._along
        square = dotted(away, away)
        nearest = np.argmin(square.real, axis=1)
        rows = np.arange(len(centre))
        length = np.sqrt(square[rows, nearest])
        safe = np.where(length.real > 0.0, length, 1.0)
        return length, away[rows, nearest] / safe[:, None]
