"""Balls and cylinders over planes, balls, boxes, capsules and meshes, in closed form.

Gaps of balls over a plane and over balls are as smooth as the motion of the bodies. Over other
solids they are the signed distances of the centres less the radii.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from mbd_ros.core.geometry.feature_gaps import (
    Meeting,
    Touch,
    directions,
    framed,
    nearest_bases,
)
from mbd_ros.core.geometry.shapes import Balls, Box, Capsule, Cylinder, Mesh, Polyhedron
from mbd_ros.core.kinematics.poses import cross, dot, lengths
from mbd_ros.core.kinematics.relative_motion import PairMotion
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array, is_symbol

_ALL = slice(0, 6)
_ORDER = [2, 0, 1]
PLANE_AXES = np.eye(3)[_ORDER]  # normal, x and y of a plane
BESIDE = 1.0e-6  # of the size of a face: how far beside it a point still counts as on it
Distance = Callable[[Array], tuple[Array, Array]]
"""Centres in the axes of a solid, shape (n, 3) -> signed distances and outward normals."""
_UPRIGHT = 1.0e-9  # sine of a tilt below which no point of a rim is the lowest
_AROUND = ("low", "left", "high", "right")


class BallsOnPlane(Meeting):
    """Balls over the half space z <= 0: g = c_z - r.

    Args:
        pair: The half space, as the observer, and the body with the balls.
    """

    def __init__(self, pair: Pair, balls: Balls) -> None:
        super().__init__(pair, balls.names)
        self.reach = balls.reach
        self._centres = balls.centres
        self._radii = balls.radii
        n = len(balls.names)
        self._axes = np.broadcast_to(PLANE_AXES, (n, 3, 3))
        self._rows = np.zeros((n, 3, 6))
        self._rows[:, :, :3] = PLANE_AXES
        self._down = np.column_stack((np.zeros((n, 2)), -balls.radii))
        self._radius: float | None = None
        if n == 1:  # its centre is the origin of the moving body
            self._radius = float(balls.radii[0])
            self._rows[0, :, 3:] = cross(self._down, PLANE_AXES)

    def gaps(self, seen: PairMotion) -> Array:
        """Distances of the surfaces [m], shape (n,)."""
        if self._radius is not None:
            return np.array((seen.offset()[2] - self._radius,))
        pose = seen.pose()
        gaps: Array = self._centres.dot(pose.rotation[2]) + (pose.translation[2] - self._radii)
        return gaps

    def touch(self, pose: Any) -> Touch:
        """The lowest points of the balls; frames are that of the plane."""
        lever = self._centres.dot(pose.rotation.T) + self._down
        return Touch(lever[:, 2] + pose.translation[2], lever, self._axes)

    def jacobian(self, seen: PairMotion) -> Array:
        """From joint velocities to those of the features, shape (3 n, nv)."""
        rows = self._rows
        if self._radius is None:
            rows = self._level(self._centres.dot(seen.rotation().T))
        jacobian: Array = rows.reshape(-1, 6).dot(seen.jacobian(seen.placed(), _ALL))
        return jacobian

    def accelerations(self, seen: PairMotion) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`."""
        rows, drift = self._drift(seen)
        jacobian: Array = rows.reshape(-1, 6).dot(seen.jacobian(seen.placed(), _ALL))
        return jacobian, drift

    def drift(self, seen: PairMotion) -> Array:
        """J' v, shape (3 n,); frames are at rest and centres are carried by the body."""
        return self._drift(seen)[1]

    def _drift(self, seen: PairMotion) -> tuple[Array, Array]:
        """The rows of the features, shape (n, 3, 6), and `drift`."""
        a, omega, alpha = seen.motion(seen.place())
        drift: Array
        if self._radius is not None:
            drift = self._rows.reshape(-1, 6).dot(np.concatenate((a, alpha)))
            return self._rows, drift
        carried = self._centres.dot(seen.rotation().T)
        rows = self._level(carried)
        drift = rows.reshape(-1, 6).dot(np.concatenate((a, alpha)))
        spinning = np.outer(omega, omega[_ORDER])
        spinning -= omega.dot(omega) * PLANE_AXES.T
        drift += carried.dot(spinning).ravel()
        return rows, drift

    def _level(self, carried: Array) -> Array:
        """Rows whose levers reach to centres in the axes of the plane, from their body."""
        x, y, z = (carried + self._down).T
        levers = self._rows
        if is_symbol(z[0]):
            levers = levers.astype(object)
        levers[:, 0, 3], levers[:, 0, 4] = y, -x
        levers[:, 1, 4], levers[:, 1, 5] = z, -y
        levers[:, 2, 3], levers[:, 2, 5] = -z, x
        return levers


class BallsOnBalls(Meeting):
    """Each ball of one body over each of another: g = |d| - r_a - r_b, d between the centres.

    Args:
        pair: The body at rest, as the observer, and the moving one.
        moving: Balls of the moving one.
        resting: Balls of the other.
        basis: Normal and tangents that are turned to the normal, in the axes of the observer,
            shape (3, 3), rows.
    """

    def __init__(self, pair: Pair, moving: Balls, resting: Balls, basis: Array) -> None:
        n, m = len(moving.names), len(resting.names)
        names = moving.names
        if m > 1:
            names = tuple(f"{a}_on_{b}" for a in moving.names for b in resting.names)
        super().__init__(pair, names)
        self.reach = moving.reach
        self._centres = np.repeat(moving.centres, m, axis=0)
        self._radii = np.repeat(moving.radii, m)
        self._others = np.tile(resting.centres, (n, 1))
        self._sum = self._radii + np.tile(resting.radii, n)
        self._basis = basis

    def touch(self, pose: Any) -> Touch:
        """Points of the moving balls that are nearest to the others."""
        carried = self._centres.dot(pose.rotation.T)
        offset = carried + pose.translation - self._others
        length = lengths(offset)
        normal = directions(offset, length, self._basis[0])
        lever = carried - self._radii[:, None] * normal
        return Touch(length - self._sum, lever, framed(normal, self._basis))


class BallsOnSolid(Meeting):
    """Balls over a solid: g is the signed distance of the centre less the radius.

    Args:
        pair: The solid, as the observer, and the body with the balls.
        solid: What they are over, centred at the origin of the observer.
    """

    def __init__(self, pair: Pair, balls: Balls, solid: Box | Capsule | Cylinder | Mesh) -> None:
        super().__init__(pair, balls.names)
        self.reach = balls.reach
        self._centres = balls.centres
        self._radii = balls.radii
        self._distance, what = _distance_to(solid)
        self.why_not = f"the curvature of a {what} jumps where its sides meet"

    def touch(self, pose: Any) -> Touch:
        """Points of the balls that are nearest to the solid."""
        carried = self._centres.dot(pose.rotation.T)
        distance, normal = self._distance(carried + pose.translation)
        lever = carried - self._radii[:, None] * normal
        return Touch(distance - self._radii, lever, framed(normal, nearest_bases(normal)))


def _distance_to(solid: Box | Capsule | Cylinder | Mesh) -> tuple[Distance, str]:
    if isinstance(solid, Capsule):
        return _to_capsule(solid.radius, solid.length / 2.0), "capsule"
    if isinstance(solid, Cylinder):
        return _to_cylinder(solid.radius, solid.length / 2.0), "cylinder"
    if isinstance(solid, Mesh):
        return _to_mesh(solid.body, BESIDE * solid.body.size), "mesh"
    return _to_box(solid.sides / 2.0), "box"


def _to_capsule(radius: float, half: float) -> Distance:
    def distance(centre: Array) -> tuple[Array, Array]:
        offset = centre.copy()
        z = centre[:, 2]
        offset[:, 2] = z - np.where(np.abs(z.real) <= half, z, half * np.sign(z.real))
        far = lengths(offset)
        is_axis = far.real == 0.0
        normal = offset / np.where(is_axis, 1.0, far)[:, None]
        normal[is_axis, 0] = 1.0
        return far - radius, normal

    return distance


def _to_cylinder(radius: float, half: float) -> Distance:
    beside = BESIDE * max(radius, half)

    def distance(centre: Array) -> tuple[Array, Array]:
        z = centre[:, 2]
        up = np.where(z.real < 0.0, -1.0, 1.0)
        around = centre.copy()
        around[:, 2] = 0.0
        far = lengths(around)
        is_axis = far.real == 0.0
        outward = around / np.where(is_axis, 1.0, far)[:, None]
        outward[is_axis, 0] = 1.0
        beyond = np.stack((far - radius, up * z - half), axis=1)
        outside = np.where(beyond.real > 0.0, beyond, 0.0)
        length = lengths(outside)
        over_cap = (np.abs(z.real).min() - half >= far.real.min() - radius) & (
            outside[:, 0].real <= beside
        )
        cap = np.zeros_like(centre)
        cap[:, 2] = up
        is_inside = length.real == 0.0
        share = outside / np.where(is_inside, 1.0, length)[:, None]
        normal = share[:, :1] * outward + share[:, 1:] * cap
        side_first = beyond[:, 0].real > beyond[:, 1].real
        inner = np.where(side_first[:, None], outward, cap)
        gap = np.where(is_inside, np.where(side_first, beyond[:, 0], beyond[:, 1]), length)
        normal = np.where(is_inside[:, None], inner, normal)
        gap = np.where(over_cap, beyond[:, 1] + outside[:, 0], gap)
        return gap, np.where(over_cap[:, None], cap, normal)

    return distance


def _to_mesh(body: Polyhedron, beside: float) -> Distance:
    """Distances to a convex body with flat faces; points so far beside a face [m] are over it."""
    rings = [body.vertices[face] for face in body.faces]
    starts = np.concatenate(rings)
    along = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    squares = dot(along, along)
    sizes = [len(ring) for ring in rings]
    first = np.cumsum([0, *sizes[:-1]])
    outward = cross(along, np.repeat(body.normals, sizes, axis=0))
    outward = outward / lengths(outward)[:, None]
    edge_offsets = dot(outward, starts)

    def distance(centre: Array) -> tuple[Array, Array]:
        height = centre @ body.normals.T - body.offsets
        aside = np.maximum.reduceat(centre.real @ outward.T - edge_offsets, first, axis=1)
        over = aside <= beside
        rows, highest = np.arange(len(centre)), np.argmax(height.real, axis=1)
        is_inside = height.real[rows, highest] <= 0.0
        common = int(np.argmax(height.real.min(axis=0)))  # one face for all points over it
        is_near = is_inside | (height.real[:, common] >= -beside)
        face = np.where(over[:, common] & is_near, common, highest)
        gap, normal = height[rows, face], body.normals[face].astype(centre.dtype)
        on_face = is_inside | over[rows, face]
        if not on_face.all():
            far, away = to_edges(centre)
            gap = np.where(on_face, gap, far)
            normal = np.where(on_face[:, None], normal, away)
        return gap, normal

    def to_edges(centre: Array) -> tuple[Array, Array]:
        """Distance to the nearest edge, and the direction from there."""
        offset = centre[:, None] - starts
        share = dot(offset, along) / squares
        share = np.where(share.real < 0.0, 0.0, np.where(share.real > 1.0, 1.0, share))
        away = offset - share[:, :, None] * along
        square = dot(away, away)
        nearest = np.argmin(square.real, axis=1)
        rows = np.arange(len(centre))
        length = np.sqrt(square[rows, nearest])
        safe = np.where(length.real > 0.0, length, 1.0)
        return length, away[rows, nearest] / safe[:, None]

    return distance


def _to_box(half: Array) -> Distance:
    beside = BESIDE * float(half.max())
    axes = np.arange(3)

    def distance(centre: Array) -> tuple[Array, Array]:
        sign = np.where(centre.real < 0.0, -1.0, 1.0)
        beyond = sign * centre - half
        outside = np.where(beyond.real > 0.0, beyond, 0.0)
        far = lengths(outside)
        # One face for all balls over it: some may be deeper in it than a side is near.
        spread = np.concatenate((centre.real.min(axis=0), -centre.real.max(axis=0)))
        face = int(np.argmax(spread - np.tile(half, 2)))
        up, axis = (1.0 if face < len(half) else -1.0), face % len(half)
        aside = lengths(outside[:, axes != axis])
        on_face = (aside.real <= beside) & (up * centre[:, axis].real > -half[axis])
        deepest = np.argmax(beyond.real, axis=1)
        inner = np.zeros_like(sign)
        rows = np.arange(len(centre))
        inner[rows, deepest] = sign[rows, deepest]
        is_inside = far.real == 0.0
        gap = np.where(is_inside, beyond[rows, deepest], far)
        normal = outside * sign / np.where(is_inside, 1.0, far)[:, None]
        normal = np.where(is_inside[:, None], inner, normal)
        flat = up * np.eye(3)[axis]
        gap = np.where(on_face, up * centre[:, axis] - half[axis] + aside, gap)
        return gap, np.where(on_face[:, None], flat, normal)

    return distance


class CylinderOnPlane(Meeting):
    """A cylinder over the half space z <= 0.

    `low_0` and `low_1` are the lowest points of both rims, at the lower and at the upper end
    along its axis; `left`, `high` and `right` stand at 90, 180 and 270 degrees from them.
    None of them is fixed to the body: they roll over the rims, so that a cylinder on its side
    touches with its two lowest points alone. There `left` and `right` are at the centres of its
    ends, since points of the rim would be on their way into the plane. Where it stands upright
    `low` is at -x of the body.

    Args:
        pair: The half space, as the observer, and the centre of the cylinder.
    """

    why_not = "the lowest point of the rim of a cylinder jumps where it stands upright"

    def __init__(self, pair: Pair, cylinder: Cylinder) -> None:
        super().__init__(pair, tuple(f"{way}_{end}" for end in (0, 1) for way in _AROUND))
        self._radius = cylinder.radius
        self._half = cylinder.length / 2.0
        self.reach = float(np.hypot(self._radius, self._half))
        self._axes = np.broadcast_to(PLANE_AXES, (len(self.features), 3, 3))

    def touch(self, pose: Any) -> Touch:
        """Points of the rims; frames are that of the plane."""
        R = pose.rotation
        along = R[:, 2]
        down = along * along[2]
        down[2] -= 1.0  # what of -z is across the axis
        sine = np.sqrt(down.dot(down))
        low = -R[:, 0] if sine.real < _UPRIGHT else down / sine
        left = cross(along, low) * along[2] ** 2
        rim = self._radius * np.stack((low, left, -low, -left))
        end = self._half * along
        lever = np.concatenate((rim - end, rim + end))
        return Touch(lever[:, 2] + pose.translation[2], lever, self._axes)
