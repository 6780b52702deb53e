"""Wraps over the inner side of a ring: a geodesic between two tangents."""

import numpy as np

from mbd_ros.core.kinematics.paths.cylinder import Cylinder
from mbd_ros.core.kinematics.paths.wrap_surface import (
    MAY_WRAP,
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

_LONG = 1.0e3  # of the cylinder in place of the ring, in radii of the ring
_LOOK = np.linspace(-1.0, 2.0, 61)  # where a line may be nearest to the ring, in lines


class Torus(Surface):
    """A ring about z that paths go through: a tube about a circle in the plane of x and y.

    Whether a path wraps, and where the search for the geodesic starts, say the cylinder along the
    ring where the line comes nearest to it, of which the path goes over the inner half.

    Args:
        inner: Radius of the tube [m], > 0.
        outer: Radius of the circle [m], > inner.
        side: Half of the ring that the nearest point must be on, or all.
    """

    def __init__(self, inner: float, outer: float, side: Side = "all") -> None:
        super().__init__(side)
        self._r = inner
        self._R = outer
        self.size = inner
        self.outer = outer
        self._cylinder = Cylinder(inner, _LONG * outer, "x")

    def holds(self, points: Array) -> Mask:
        """Whether points are inside of the tube, shape (n,)."""
        tube = points - self._middle(points)[0]
        inside: Mask = dot(tube, tube) < self._r**2
        return inside

    def meets(self, a: Array, b: Array) -> Numbers:
        """Return whether a path from a to b wraps: `NO_WRAP` or `MAY_WRAP`, shape (n,)."""
        near = self._closest(a, b)
        code = self._cylinder.meets(*self._beside(near, a, b)[2:])
        if self.sign:
            code = np.where(self.on_side(near), code, NO_WRAP)
        outside = ~(self.holds(a) | self.holds(b))
        return np.where(outside, np.minimum(code, MAY_WRAP), NO_WRAP)

    def touch(self, a: Array, b: Array, code: Numbers) -> Touch:
        """Where a path from a to b touches it, with what `meets` says."""
        axes, centre, a_in, b_in = self._beside(self._closest(a, b), a, b)
        code, start, direction, arc = self._cylinder.touch(a_in, b_in, code)
        start = self.nearest(np.einsum("nji,nj->ni", axes, start) + centre)
        along, n = np.einsum("nji,nj->ni", axes, direction), self.normal(start)
        direction = unit(along - dot(along, n)[:, None] * n)
        return Touch(code, start, direction, arc)

    def _beside(self, near: Array, a: Array, b: Array) -> tuple[Array, Array, Array, Array]:
        """Axes and origin of the cylinder along the ring, and both ends in them."""
        out = unit(near * (1.0, 1.0, 0.0))
        axes = np.stack((-out, np.broadcast_to((0.0, 0.0, -1.0), out.shape), out), axis=1)
        axes[:, 2] = cross(axes[:, 0], axes[:, 1])
        centre = self._R * out
        a_in, b_in = (np.einsum("nij,nj->ni", axes, p - centre) for p in (a, b))
        return axes, centre, a_in, b_in

    def normal(self, points: Array) -> Array:
        """Unit outward normals, shape (n, 3)."""
        return unit(points - self._middle(points)[0])

    def bend(self, points: Array, along: Array) -> Array:
        """Change of the normal along tangents, shape (n, 3)."""
        _, rho, turn = self._middle(points)
        around = (self._R / rho * dot(turn, along))[..., None] * turn
        return np.asarray((along - around) / self._r)

    def nearest(self, points: Array) -> Array:
        """Points on the torus, shape (n, 3)."""
        return np.asarray(self._middle(points)[0] + self._r * self.normal(points))

    def flow(self, start: Array, direction: Array, arc: Array) -> Flow:
        """Geodesics."""
        return geodesics(self._curving, start, direction, arc, 1.0 / self._r)

    def _curving(self, points: Array, tangents: Array) -> tuple[Array, Array]:
        x, y, z = points
        rho = np.sqrt(x * x + y * y)
        share = self._R / rho
        n = np.stack((x - share * x, y - share * y, z))
        around = (x * tangents[1] - y * tangents[0]) / rho
        square = dot3(n, n)  # of the radius of the tube
        bend = dot3(tangents, tangents) - share * around * around
        gauss = (rho - self._R) / (self._r**2 * rho)
        return (-bend / square) * n, gauss

    def _middle(self, points: Array) -> tuple[Array, Array, Array]:
        """Nearest points of the circle, distances to z, and the direction around z."""
        flat = points * (1.0, 1.0, 0.0)
        rho = np.sqrt(dot(flat, flat))
        rho = np.where(rho > 0.0, rho, 1.0e-300)
        out = flat / rho[..., None]
        turn = np.stack((-out[..., 1], out[..., 0], np.zeros(rho.shape)), axis=-1)
        return self._R * out, rho, turn

    def _closest(self, a: Array, b: Array) -> Array:
        """The point of every line through a and b that is nearest to the circle, shape (n, 3)."""
        line = b - a
        ways = a[:, None, :] + _LOOK[:, None] * line[:, None, :]
        best = np.argmin(self._square(ways), axis=1)
        at = _LOOK[best]
        for _ in range(30):
            point = a + at[:, None] * line
            rho = np.maximum(np.hypot(point[:, 0], point[:, 1]), 1.0e-300)
            radial = dot(point[:, :2], line[:, :2]) / rho
            slope = dot(point, line) - self._R * radial
            flat = dot(line[:, :2], line[:, :2])
            bent = dot(line, line) - self._R * (flat - radial**2) / rho
            step = slope / np.where(bent > 0.0, bent, dot(line, line))
            at = at - np.clip(step, -0.05, 0.05)
            if not np.abs(step).max(initial=0.0) > 1.0e-15:
                break
        return np.asarray(a + at[:, None] * line)

    def _square(self, points: Array) -> Array:
        rho = np.sqrt(points[..., 0] ** 2 + points[..., 1] ** 2)
        return np.asarray((rho - self._R) ** 2 + points[..., 2] ** 2)
