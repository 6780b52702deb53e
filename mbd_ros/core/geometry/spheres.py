"""Balls over a plane and over balls, whose gaps are as smooth as the motion of the bodies."""

from typing import Any

import numpy as np

from mbd_ros.core.geometry.feature_gaps import Meeting, Touch
from mbd_ros.core.geometry.frames import crossed, directions, framed, lengths
from mbd_ros.core.geometry.shapes import Balls
from mbd_ros.core.kinematics.relative_motion import PairMotion
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array, is_symbol

_ALL = slice(0, 6)
_ORDER = [2, 0, 1]
PLANE_AXES = np.eye(3)[_ORDER]  # normal, x and y of a plane


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
        self._axes = np.broadcast_to(PLANE_AXES, (n, 3, 3))
        self._rows = np.zeros((n, 3, 6))
        self._rows[:, :, :3] = PLANE_AXES
        self._down = np.column_stack((np.zeros((n, 2)), -balls.radii))
        self._radius: float | None = None
        if n == 1:  # its centre is the origin of the moving body
            self._radius = float(balls.radii[0])
            self._rows[0, :, 3:] = crossed(self._down, PLANE_AXES)

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
