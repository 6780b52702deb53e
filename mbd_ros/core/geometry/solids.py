"""Balls over boxes, capsules and cylinders: signed distances of their centres."""

from collections.abc import Callable
from typing import Any

import numpy as np

from mbd_ros.core.geometry.feature_gaps import Meeting, Touch
from mbd_ros.core.geometry.frames import framed, lengths, nearest_bases
from mbd_ros.core.geometry.shapes import Balls, Box, Capsule, Cylinder, Mesh
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array

BESIDE = 1.0e-6  # of the size of a face: how far beside it a point still counts as on it
Distance = Callable[[Array], tuple[Array, Array]]
"""Centres in the axes of a solid, shape (n, 3) -> signed distances and outward normals."""


class BallsOnSolid(Meeting):
    """Balls over a solid: g is the signed distance of the centre less the radius.

    Args:
        pair: The solid, as the observer, and the body with the balls.
        balls: The balls.
        solid: What they are over, centred at the origin of the observer.
    """

    def __init__(self, pair: Pair, balls: Balls, solid: Box | Capsule | Cylinder | Mesh) -> None:
        super().__init__(pair, balls.names)
        self.reach = balls.reach
        self._centres, self._radii = balls.centres, balls.radii
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
        from mbd_ros.core.geometry.mesh_distance import ToMesh

        return ToMesh(solid.body, BESIDE * solid.body.size), "mesh"
    return _to_box(solid.sides / 2.0), "box"


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
