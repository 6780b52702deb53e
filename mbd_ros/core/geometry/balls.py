"""Balls over a plane and over balls, whose gaps are as smooth as the motion of the bodies."""

import math
from typing import Any

import numpy as np

from mbd_ros.core.geometry.meeting import Meeting, Touch, Turning, crossed
from mbd_ros.core.geometry.shapes import Balls
from mbd_ros.core.model.pair_motion import PairMotion, Placed
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array

_ALL = slice(0, 6)
_AXES = np.eye(3)[[2, 0, 1]]  # normal, x and y of a plane
_OPPOSITE = 1.0e-6  # length of a sum of unit vectors below which they are opposite


class BallsOnPlane(Meeting):
    """Balls over the half space z <= 0: g = c_z - r.

    Args:
        pair: The half space, as the observer, and the body with the balls.
        balls: The balls.
    """

    def __init__(self, pair: Pair, balls: Balls) -> None:
        super().__init__(pair, balls.names)
        self.reach = balls.reach
        self._centres, self._radii = balls.centres, balls.radii
        n = len(balls.names)
        self._axes = np.broadcast_to(_AXES, (n, 3, 3))
        self._still = np.zeros((n, 3)), np.zeros(n)
        self._rows = np.zeros((n, 3, 6))
        self._rows[:, :, :3] = _AXES
        self._down = np.column_stack((np.zeros((n, 2)), -balls.radii))
        self._radius: float | None = None
        if n == 1:  # its centre is the origin of the moving body
            self._radius = float(balls.radii[0])
            self._rows[0, :, 3:] = crossed(self._down, _AXES)

    def gaps(self, seen: PairMotion) -> Array:
        """Distances of the surfaces [m], shape (n,)."""
        if self._radius is not None:
            return np.array((float(seen.offset()[2]) - self._radius,))
        pose = seen.pose()
        gaps: Array = self._centres.dot(pose.rotation[2]) + (pose.translation[2] - self._radii)
        return gaps

    def touch(self, pose: Any) -> Touch:
        """The lowest points of the balls; frames are that of the plane."""
        return Touch(self._centres.dot(pose.rotation.T) + self._down, self._axes)

    def turning(self, pose: Any, touch: Touch, velocity: Any) -> Turning:
        """The centres move with the body, the frames never."""
        return Turning(crossed(velocity.angular, touch.lever - self._down), *self._still)

    def jacobian(self, seen: PairMotion, placed: Placed | None) -> Array:
        """From joint velocities to those of the features, shape (3 n, nv)."""
        if self._radius is None:
            x, y, z = (self._centres.dot(seen.rotation().T) + self._down).T
            levers = self._rows
            levers[:, 0, 3], levers[:, 0, 4] = y, -x
            levers[:, 1, 4], levers[:, 1, 5] = z, -y
            levers[:, 2, 3], levers[:, 2, 5] = -z, x
        jacobian: Array = self._rows.reshape(-1, 6).dot(seen.jacobian(placed, _ALL))
        return jacobian

    def drift(self, seen: PairMotion, placed: Placed) -> Array:
        """J' v, shape (3 n,)."""
        if self._radius is None:
            return super().drift(seen, placed)
        a, _, alpha = seen.motion(placed)
        drift: Array = self._rows[0].dot(np.concatenate((a, alpha)))
        return drift


class BallsOnBalls(Meeting):
    """Each ball of one body over each of another: g = |d| - r_a - r_b, d between the centres.

    Tangents are those of a basis that the smallest rotation brings from its normal to n; opposite
    to that normal they have no direction of their own.

    Args:
        pair: The body at rest, as the observer, and the moving one.
        moving: Balls of the moving one.
        resting: Balls of the other.
        basis: Normal and tangents in the axes of the observer, shape (3, 3), rows.
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

    def gaps(self, seen: PairMotion) -> Array:
        """Distances of the surfaces [m], shape (n,)."""
        return self._offsets(seen.pose())[1] - self._sum

    def touch(self, pose: Any) -> Touch:
        """Points of the moving balls that are nearest to the others."""
        offset, length = self._offsets(pose)
        normal = offset / np.where(length > 0.0, length, 1.0)[:, None]
        normal[length == 0.0] = self._basis[0]
        lever = self._centres.dot(pose.rotation.T) - self._radii[:, None] * normal
        return Touch(lever, framed(normal, self._basis))

    def turning(self, pose: Any, touch: Touch, velocity: Any) -> Turning:
        """The normal follows the centre of the ball, the point is on its surface."""
        _, length = self._offsets(pose)
        normal = touch.axes[:, 0]
        carried = crossed(velocity.angular, touch.lever + self._radii[:, None] * normal)
        moved = velocity.linear + carried
        along = np.einsum("nj,nj->n", normal, moved)
        change = (moved - along[:, None] * normal) / np.maximum(length, 1e-300)[:, None]
        lever = carried - self._radii[:, None] * change
        return Turning(lever, change, spin(normal, change, self._basis))

    def _offsets(self, pose: Any) -> tuple[Array, Array]:
        """From the centres at rest to the moving ones [m], shape (n, 3), and how long they are."""
        offset = self._centres.dot(pose.rotation.T) + pose.translation - self._others
        return offset, np.sqrt(np.einsum("nj,nj->n", offset, offset))


def framed(normal: Array, basis: Array) -> Array:
    """Normals and tangents, the basis turned by the smallest rotation, shape (n, 3, 3), rows.

    Args:
        normal: Shape (n, 3).
        basis: Normal and tangents, shape (3, 3), rows.
    """
    total = normal + basis[0]
    square = np.einsum("nj,nj->n", total, total) / 2.0
    axes = np.empty((len(normal), 3, 3))
    axes[:, 0] = normal
    for i in (1, 2):
        share = normal.dot(basis[i]) / np.maximum(square, _OPPOSITE**2)
        axes[:, i] = basis[i] - share[:, None] * total
    opposite = square < _OPPOSITE**2
    if opposite.any():
        axes[opposite, 2] *= -1.0
    return axes


def spin(normal: Array, change: Array, basis: Array) -> Array:
    """Rate of the tangents of `framed` about the normal [rad/s], shape (n,).

    Args:
        normal: Shape (n, 3).
        change: Its derivative [1/s], same shape.
        basis: As for `framed`.
    """
    total = normal + basis[0]
    square = np.einsum("nj,nj->n", total, total) / 2.0
    n, rate = normal.dot(basis[1:].T), change.dot(basis[1:].T)
    turned: Array = rate[:, 0] * n[:, 1] - n[:, 0] * rate[:, 1]
    return turned / np.maximum(square, _OPPOSITE**2)


def nearest_basis(normal: Array) -> Array:
    """The right-handed basis along axes whose normal is nearest to a direction, rows.

    Args:
        normal: Any direction, shape (3,).
    """
    axis = int(np.argmax(np.abs(normal)))
    sign = math.copysign(1.0, float(normal[axis]))
    basis = np.roll(np.eye(3), -axis, axis=0)
    basis[0] *= sign
    basis[2] *= sign
    return basis
