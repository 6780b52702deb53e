"""Wraps over a cylinder: a helix between two tangents."""

import numpy as np

from mbd_ros.core.kinematics.paths.wrap_surface import (
    MAY_WRAP,
    MUST_WRAP,
    NO_WRAP,
    Flow,
    Mask,
    Numbers,
    Side,
    Surface,
    Touch,
)
from mbd_ros.core.kinematics.poses import dot
from mbd_ros.core.state import Array

_TURN = 2.0 * np.pi


class Cylinder(Surface):
    """A cylinder about z. Paths that would touch it beyond both ends do not wrap.

    Unrolled, the path is a straight line: with the length s of its projection along z (two
    tangents and an arc) and its rise h the length is sqrt(s^2 + h^2).

    Args:
        radius: > 0 [m].
        length: Along z, half of it on either side of the origin [m].
        side: Half that the path must go over, or all.
    """

    is_closed_form = True

    def __init__(self, radius: float, length: float, side: Side = "all") -> None:
        super().__init__(side)
        self.size = radius
        self.half_length = length / 2.0

    def holds(self, points: Array) -> Mask:
        """Whether points are nearer to the axis than the radius, shape (n,)."""
        inside: Mask = points[:, 0] ** 2 + points[:, 1] ** 2 < self.size**2
        return inside

    def touch(self, a: Array, b: Array, code: Numbers) -> Touch:
        """Where a path from a to b touches it, with what `meets` says."""
        if self.sign:
            left = self._turns_left(a, b)
        else:
            left = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] >= 0.0  # the shorter way
        radius, turn = self.size, np.where(left, 1.0, -1.0)
        (to_a, begin), (to_b, end) = self._tangent(a, turn), self._tangent(b, -turn)
        angle = np.remainder(turn * (end - begin), _TURN)
        angle = np.where(angle > _TURN - 1.0e-9, 0.0, angle)
        flat = to_a + radius * angle + to_b
        slope = (b[:, 2] - a[:, 2]) / flat
        first, last = a[:, 2] + slope * to_a, b[:, 2] - slope * to_b
        beyond = (np.abs(first) > self.half_length) & (np.abs(last) > self.half_length)
        c, s, steep = np.cos(begin), np.sin(begin), np.sqrt(1.0 + slope * slope)
        direction = np.stack((-turn * s / steep, turn * c / steep, slope / steep), axis=-1)
        start = np.stack((radius * c, radius * s, first), axis=-1)
        return Touch(np.where(beyond, NO_WRAP, code), start, direction, radius * angle * steep)

    def normal(self, points: Array) -> Array:
        """Unit outward normals, shape (n, 3)."""
        flat = points * (1.0, 1.0, 0.0)
        return np.asarray(flat / np.sqrt(dot(flat, flat))[:, None])

    def bend(self, points: Array, along: Array) -> Array:
        """Change of the normal along tangents, shape (n, 3)."""
        return np.asarray(along * (1.0, 1.0, 0.0) / self.size)

    def nearest(self, points: Array) -> Array:
        """Points on the cylinder, shape (n, 3)."""
        return np.asarray(self.size * self.normal(points) + points * (0.0, 0.0, 1.0))

    def flow(self, start: Array, direction: Array, arc: Array) -> Flow:
        """Helices."""
        n, rise = self.normal(start), direction[:, 2]
        around = -direction[:, 0] * n[:, 1] + direction[:, 1] * n[:, 0]
        angle = around * arc / self.size
        c, s, flat = np.cos(angle), np.sin(angle), np.zeros(len(arc))
        x, y = c * n[:, 0] - s * n[:, 1], s * n[:, 0] + c * n[:, 1]
        end = np.stack((self.size * x, self.size * y, start[:, 2] + rise * arc), axis=-1)
        straight = np.ones(len(arc))
        return Flow(
            end,
            np.stack((-around * y, around * x, rise), axis=-1),
            np.stack((straight, flat), axis=-1),
            np.stack((arc, straight), axis=-1),
            start + 0.5 * (end - start),
        )

    def meets(self, a: Array, b: Array) -> Numbers:
        """Return `NO_WRAP`, `MAY_WRAP` or `MUST_WRAP` for paths from a to b, shape (n,)."""
        line = b - a
        flat = line[:, 0] ** 2 + line[:, 1] ** 2
        at = -(a[:, 0] * line[:, 0] + a[:, 1] * line[:, 1]) / np.where(flat > 0.0, flat, 1.0)
        near = a + at[:, None] * line
        hits = (near[:, 0] ** 2 + near[:, 1] ** 2 < self.size**2) & (at > 0.0) & (at < 1.0)
        outside = ~(self.holds(a) | self.holds(b))
        if not self.sign:
            return np.where(hits & outside, MUST_WRAP, NO_WRAP)
        there_a, there_b = self.on_side(a), self.on_side(b)
        behind = (there_a != there_b) & ~self.on_side(near)
        beside = np.where(hits, MUST_WRAP, np.where(behind, MAY_WRAP, NO_WRAP))
        code = np.where(there_a | there_b, beside, MAY_WRAP)
        return np.where(outside, code, NO_WRAP)

    def _turns_left(self, a: Array, b: Array) -> Mask:
        """By which points of contact are on the side, those of a first, as OpenSim decides."""
        (_, left_a), (_, right_a) = self._tangent(a, 1.0), self._tangent(a, -1.0)
        (_, left_b), (_, right_b) = self._tangent(b, 1.0), self._tangent(b, -1.0)
        on = [
            self.on_side(self._at(angle, point))
            for angle, point in ((left_a, a), (right_a, a), (left_b, b), (right_b, b))
        ]
        alpha = np.arccos(np.cos(left_a - right_b))
        wide = np.where(on[0], ~on[2], np.where(on[2] | on[3], ~on[2], alpha > self._beta(a, b)))
        return np.where(on[0] != on[1], on[0], wide)

    def _beta(self, a: Array, b: Array) -> Array:
        """Angle between the points of contact of the way to the right, shape (n,)."""
        (_, right), (_, left) = self._tangent(a, -1.0), self._tangent(b, 1.0)
        return np.asarray(np.arccos(np.cos(right - left)))

    def _at(self, angle: Array, point: Array) -> Array:
        c, s = np.cos(angle), np.sin(angle)
        return np.stack((self.size * c, self.size * s, point[:, 2]), axis=-1)

    def _tangent(self, point: Array, turn: Array | float) -> tuple[Array, Array]:
        """Distance to the point of contact along z [m] and its angle about z, shape (n,)."""
        square = point[:, 0] ** 2 + point[:, 1] ** 2
        distance = np.sqrt(np.maximum(square - self.size**2, 0.0))
        around = np.arctan2(point[:, 1], point[:, 0])
        return distance, around + turn * np.arctan2(distance, self.size)
