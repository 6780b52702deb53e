"""Wraps over an ellipsoid: a geodesic between two tangents."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.kinematics.paths.sphere import crossing
from mbd_ros.core.kinematics.paths.wrap_surface import (
    MUST_WRAP,
    NO_WRAP,
    Flow,
    Mask,
    Numbers,
    Side,
    Surface,
    Touch,
    dot3,
    geodesics,
)
from mbd_ros.core.kinematics.poses import cross, dot, unit
from mbd_ros.core.state import Array

_NEWTON = 60  # steps to the nearest point, far more than it takes
_OFF_PLANES = 1.0e-9  # in half axes: what keeps a point from planes of symmetry
_X, _W = np.polynomial.legendre.leggauss(16)


class Ellipsoid(Surface):
    """The ellipsoid with half axes along x, y and z.

    The search for the geodesic starts at the plane through both ends and the point of the surface
    that is nearest to the middle of what the line cuts off, mirrored onto the side that is asked
    for. Stretched to a sphere, tangents in a plane have a closed form.

    Args:
        half_axes: All > 0 [m], shape (3,).
        side: Half that the path must go over, or all.
    """

    def __init__(self, half_axes: Sequence[float], side: Side = "all") -> None:
        super().__init__(side)
        self._a = self.half_axes = np.array(half_axes, dtype=np.float64)
        self._h = self._a**-2.0
        self.size = float(self._a.max())
        self._sharpest = self.size / float(self._a.min()) ** 2
        self._product = float(np.prod(self._h))

    def holds(self, points: Array) -> Mask:
        """Whether points are inside, shape (n,)."""
        inside: Mask = dot(points * self._h, points) < 1.0
        return inside

    def meets(self, a: Array, b: Array) -> Numbers:
        """Return whether a path from a to b wraps: `NO_WRAP` or `MUST_WRAP`, shape (n,)."""
        hits, _ = crossing(a / self._a, b / self._a)
        return np.where(hits & ~(self.holds(a) | self.holds(b)), MUST_WRAP, NO_WRAP)

    def touch(self, a: Array, b: Array, code: Numbers) -> Touch:
        """Where a path from a to b touches it, with what `meets` says."""
        return self._touch(a, b, code, self.sign)

    def plain(self, a: Array, b: Array) -> Touch:
        """Return the contact of `touch` on the nearer side."""
        return self._touch(a, b, self.meets(a, b), 0.0)

    def _touch(self, a: Array, b: Array, code: Numbers, sign: float) -> Touch:
        u, v = a / self._a, b / self._a
        _, middle = crossing(u, v)
        top = self._nearest_outside(middle * self._a)
        if sign:
            top[:, self.axis] = sign * np.abs(top[:, self.axis])
        normal = unit(cross(v - u, top / self._a - u))
        centre = dot(normal, u)[:, None] * normal
        rho = np.sqrt(np.maximum(1.0 - dot(centre, centre), 0.0))
        first, ahead = self._rim(u - centre, rho, cross(normal, u - centre))
        last, _ = self._rim(v - centre, rho, -cross(normal, v - centre))
        sine, cosine = dot(cross(last, first), normal), dot(last, first)
        angle = np.remainder(np.arctan2(sine, cosine), 2.0 * np.pi)
        start = self._a * (centre + rho[:, None] * first)
        direction = unit(self._a * ahead)
        arc = self._arc(rho, first, ahead, angle)
        return Touch(code, start, direction, arc)

    def normal(self, points: Array) -> Array:
        """Unit outward normals, shape (n, 3)."""
        return unit(points * self._h)

    def bend(self, points: Array, along: Array) -> Array:
        """Change of the normal along tangents, shape (n, 3)."""
        steep = points * self._h
        length = np.sqrt(dot(steep, steep))[:, None]
        n, change = steep / length, along * self._h / length
        return np.asarray(change - dot(n, change)[:, None] * n)

    def nearest(self, points: Array) -> Array:
        """Points on the ellipsoid, shape (n, 3)."""
        return np.asarray(points / np.sqrt(dot(points * self._h, points))[:, None])

    def flow(self, start: Array, direction: Array, arc: Array) -> Flow:
        """Geodesics."""
        return geodesics(self._curving, start, direction, arc, self._sharpest)

    def _curving(self, points: Array, tangents: Array) -> tuple[Array, Array]:
        h = self._h[:, None, None]
        steep = points * h
        square = dot3(steep, steep)
        bend = dot3(tangents, tangents * h)
        return (-bend / square) * steep, self._product / (square * square)

    def _rim(self, point: Array, rho: Array, aside: Array) -> tuple[Array, Array]:
        """Where the tangent of a point touches a circle about the origin, and its direction.

        Args:
            point: In the plane of the circle, shape (n, 3).
            rho: Radius of the circle, shape (n,).
            aside: Square to the point, on the other side than the point of contact.
        """
        distance = np.sqrt(dot(point, point))
        c = np.minimum(rho / np.where(distance > 0.0, distance, 1.0), 1.0)
        s = np.sqrt(1.0 - c * c)
        out, off = unit(point), unit(aside)
        contact = c[:, None] * out - s[:, None] * off
        return contact, -s[:, None] * out - c[:, None] * off

    def _arc(self, rho: Array, first: Array, ahead: Array, angle: Array) -> Array:
        """Length of an arc of the plane section [m], shape (n,)."""
        at = angle[:, None] * (_X + 1.0) / 2.0
        c, s = np.cos(at)[..., None], np.sin(at)[..., None]
        speed = self._a * (c * ahead[:, None, :] - s * first[:, None, :])
        return np.asarray(rho * angle / 2.0 * (np.sqrt((speed * speed).sum(axis=-1)) @ _W))

    def _nearest_outside(self, inside: Array) -> Array:
        """The nearest points of the ellipsoid from inside, shape (n, 3).

        x_i = a_i^2 p_i / (t + a_i^2) with sum x_i^2 / a_i^2 = 1, which Newton's method reaches
        from below without overshooting. Source: D. Eberly, Graphics Gems IV, 1994, p. 80, sec. 2.
        """
        square = self._a**2
        p = np.where(inside < 0.0, -1.0, 1.0) * np.maximum(np.abs(inside), _OFF_PLANES * self._a)
        scaled = self._a * p
        t = (np.abs(scaled) - square).max(axis=-1)
        for _ in range(_NEWTON):
            share = (scaled / (t[:, None] + square)) ** 2
            excess = share.sum(axis=-1) - 1.0
            step = excess / (2.0 * (share / (t[:, None] + square)).sum(axis=-1))
            t = t + step
            if not np.abs(step).max(initial=0.0) > 1.0e-15 * self.size**2:
                break
        return np.asarray(square * p / (t[:, None] + square))
