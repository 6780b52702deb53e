"""Wraps over a sphere: an arc of a great circle between two tangents."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.kinematics.paths.wrap_surface import (
    MUST_WRAP,
    NO_WRAP,
    Flow,
    Mask,
    Numbers,
    Side,
    Surface,
    Touch,
)
from mbd_ros.core.kinematics.poses import cross, dot, unit
from mbd_ros.core.state import Array


class Sphere(Surface):
    """A sphere about the origin.

    The path lies in the plane of its ends and the centre, so that it has a closed form.

    Args:
        radius: > 0 [m].
        side: Half that the path must go over, or all.
    """

    is_closed_form = True

    def __init__(self, radius: float, side: Side = "all") -> None:
        super().__init__(side)
        self.size = radius

    def holds(self, points: Array) -> Mask:
        """Whether points are nearer to the centre than the radius, shape (n,)."""
        inside: Mask = dot(points, points) < self.size**2
        return inside

    def meets(self, a: Array, b: Array) -> Numbers:
        """Return whether a path from a to b wraps: `NO_WRAP` or `MUST_WRAP`, shape (n,)."""
        hits, _ = crossing(a, b, self.size)
        return np.where(hits & ~(self.holds(a) | self.holds(b)), MUST_WRAP, NO_WRAP)

    def touch(self, a: Array, b: Array, code: Numbers) -> Touch:
        """Where a path from a to b touches it, with what `meets` says."""
        over_a, over_b = (np.sqrt(dot(p, p)) for p in (a, b))
        ahead, normal = a / over_a[:, None], cross(a, b)
        length = np.sqrt(dot(normal, normal))
        straight = length < 1.0e-12 * over_a * over_b  # no plane: one as good as another
        normal = np.where(straight[:, None], self._any_plane(a), normal)
        angle = np.arctan2(length, dot(a, b))
        rim = [np.arccos(np.minimum(self.size / p, 1.0)) for p in (over_a, over_b)]
        side = unit(cross(normal, ahead))
        far = self._goes_far(a, b, (ahead, side), angle, rim)
        way = np.where(far, -1.0, 1.0)
        arc = np.where(far, 2.0 * np.pi - angle, angle) - rim[0] - rim[1]
        c, s = np.cos(rim[0])[:, None], np.sin(rim[0])[:, None]
        side = side * way[:, None]
        start = self.size * (c * ahead + s * side)
        return Touch(code, start, c * side - s * ahead, self.size * np.maximum(arc, 0.0))

    def normal(self, points: Array) -> Array:
        """Unit outward normals, shape (n, 3)."""
        return unit(points)

    def bend(self, points: Array, along: Array) -> Array:
        """Change of the normal along tangents, shape (n, 3)."""
        return along / self.size

    def nearest(self, points: Array) -> Array:
        """Points on the sphere, shape (n, 3)."""
        return self.size * unit(points)

    def flow(self, start: Array, direction: Array, arc: Array) -> Flow:
        """Great circles."""
        r, angle = self.size, arc / self.size
        c, s = np.cos(angle), np.sin(angle)
        return Flow(
            start * c[:, None] + r * direction * s[:, None],
            direction * c[:, None] - start * (s / r)[:, None],
            np.stack((c, -s / r), axis=-1),
            np.stack((r * s, c), axis=-1),
            r * unit(start * (1.0 + c)[:, None] + r * direction * s[:, None]),
        )

    def _any_plane(self, a: Array) -> Array:
        """Normal of a plane through the centre and a, on the side where there is one."""
        if not self.sign:
            return across(a)
        normal = cross(a, np.broadcast_to(self.sign * np.eye(3)[self.axis], a.shape))
        flat = dot(normal, normal) < 1.0e-20 * dot(a, a)
        return np.where(flat[:, None], across(a), normal)

    def _goes_far(
        self,
        a: Array,
        b: Array,
        frame: tuple[Array, Array],
        angle: Array,
        rim: Sequence[Array],
    ) -> Mask:
        """Whether the path goes the long way around to be on its side, shape (n,)."""
        if not self.sign:
            return np.zeros(len(a), dtype=bool)
        ahead, side = frame
        at = -rim[0], angle + rim[1]  # points of contact on the way that does not lead to b
        sums = -(a + b)[:, self.axis]
        for turn in at:
            sums = sums + self.size * (
                np.cos(turn) * ahead[:, self.axis] + np.sin(turn) * side[:, self.axis]
            )
        both = self.on_side(a) & self.on_side(b)
        return np.asarray(~both & (self.sign * sums >= 0.0))


def crossing(a: Array, b: Array, radius: float = 1.0) -> tuple[Mask, Array]:
    """Whether lines meet a sphere between their ends, and the middle of what is inside.

    Args:
        a: Begin of lines, shape (n, 3).
        b: Their ends, shape (n, 3).
        radius: Of the sphere about the origin [m].

    Returns:
        Shapes (n,) and (n, 3).
    """
    line = b - a
    square, along, rest = dot(line, line), dot(a, line), dot(a, a) - radius**2
    square = np.where(square > 0.0, square, 1.0)
    root = along * along - square * rest
    half, middle = np.sqrt(np.maximum(root, 0.0)) / square, -along / square
    hits = (root >= 0.0) & (middle - half > 0.0) & (middle + half < 1.0)
    return hits, a + middle[:, None] * line


def across(axis_of: Array) -> Array:
    """A unit vector square to every row, along no axis in particular, shape (n, 3)."""
    least = np.eye(3)[np.argmin(np.abs(axis_of), axis=-1)]
    return unit(cross(axis_of, least))
