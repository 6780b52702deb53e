"""Contact features of two shapes: gaps, contact frames and their derivatives.

One body moves relative to the other, in whose axes all vectors are expressed. With the lever rho
from the origin of the moving body to the contact point, and an axis e of the contact frame,

    w = e . u,   u = v + omega x rho,   w' = e . (a + alpha x rho + omega x rho') + e' . u

Source: F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts, 1996, ch. 4. The
derivatives rho' and e' along the motion are those of `PairMotion.directional_derivative`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import cross, dot
from mbd_ros.core.kinematics.relative_motion import PairMotion, Pose
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array, is_symbol

_OPPOSITE = 1.0e-12  # half the square of a sum of unit vectors that are opposite
_CORNERS = np.stack([np.roll(np.eye(3), -axis, axis=0) for axis in range(3)])
BASES = np.stack((_CORNERS, _CORNERS * np.array(((-1.0,), (1.0,), (-1.0,)))), axis=1)
"""Right-handed bases along the axes, rows: of axis i upwards and downwards, (3, 2, 3, 3)."""
_ALL = slice(0, 6)


class Meeting:
    """Contact features of a moving over a resting shape; subclasses define `touch`.

    Args:
        pair: The resting shape, as the observer, and the moving body.
        features: Names of the features.

    Attributes:
        reach: Largest distance of contact points from the origin of the moving body, the second
            point of the pair [m].
        why_not: Reason why gaps are not twice differentiable; empty if they are.
    """

    reach: float = math.inf
    why_not: str = ""

    def __init__(self, pair: Pair, features: tuple[str, ...]) -> None:
        self.pair = pair
        self.features = features

    def touch(self, pose: Any) -> Touch:
        """Return gaps, contact points and frames at a real, complex or symbolic `Pose`."""
        raise NotImplementedError

    def gaps(self, seen: PairMotion) -> Array:
        """Return the distances of the surfaces, negative for overlap [m], shape (n,)."""
        return self.touch(seen.pose()).gap

    def clearance(self, seen: PairMotion, gaps: Array) -> float:
        """Return a lower bound of the distance of the bodies [m] at given gaps."""
        return float(gaps.min())

    def jacobian(self, seen: PairMotion) -> Array:
        """Return the map from joint velocities to those of the features, shape (3 n, nv)."""
        _, lever, axes = self.touch(seen.pose())
        return _rows(lever, axes).dot(seen.jacobian(seen.placed(), _ALL))

    def drift(self, seen: PairMotion) -> Array:
        """Return J' v, shape (3 n,), in frames that do not spin about their normals.

        The spin does not matter, since friction is isotropic. Tangents between balls would spin
        without bound near the normal at which they are singular.
        """
        return self.accelerations(seen)[1]

    def accelerations(self, seen: PairMotion) -> tuple[Array, Array]:
        """Return `jacobian` and `drift`, which share contact points and frames."""
        placed = seen.placed()
        v, a, omega, alpha = seen.velocity_and_motion(placed or seen.place())
        pose = seen.pose()
        rates = Pose(cross(omega, pose.rotation.T).T, v)
        (_, lever, axes), (_, lever_rate, turning) = seen.directional_derivative(
            self.touch, pose, rates
        )
        axes_rate = _unspun(axes, turning)
        slip = v + cross(omega, lever)
        a = a + cross(alpha, lever) + cross(omega, lever_rate)
        drift = np.einsum("nij,nj->ni", axes, a) + np.einsum("nij,nj->ni", axes_rate, slip)
        return _rows(lever, axes).dot(seen.jacobian(placed, _ALL)), drift.ravel()


def _rows(lever: Array, axes: Array) -> Array:
    """Return the map from the twist of the moving body to velocities of its features, (3 n, 6)."""
    rows: Array = np.concatenate((axes, cross(lever[:, None], axes)), axis=2).reshape(-1, 6)
    return rows


def _unspun(axes: Array, rate: Array) -> Array:
    """Return the rates of axes without spin about the normal, the first axis, (n, 3, 3)."""
    spin = np.einsum("nj,nj->n", rate[:, 1], axes[:, 2])[:, None]
    tangents = rate[:, 1] - spin * axes[:, 2], rate[:, 2] + spin * axes[:, 1]
    return np.stack((rate[:, 0], *tangents), axis=1)


class Touch(NamedTuple):
    """Gaps, contact points and contact frames of features at one pose.

    Attributes:
        gap: Distances of the surfaces, negative for overlap [m], shape (n,).
        lever: Vectors from the origin of the moving body to the contact points [m], shape (n, 3).
        axes: Rows: the normal out of the resting shape, then both tangents, shape (n, 3, 3).
    """

    gap: Array
    lever: Array
    axes: Array


def directions(vectors: Array, length: Array, otherwise: Array) -> Array:
    """Return vectors scaled to length 1, shape (n, 3).

    Args:
        vectors: Vectors, shape (n, 3).
        length: Lengths of the vectors, shape (n,).
        otherwise: Direction of zero vectors, shape (3,) or (n, 3).
    """
    if is_symbol(length.flat[0]):  # symbolic expressions cannot treat zero vectors
        symbolic: Array = vectors / length[:, None]
        return symbolic
    nonzero = length.real > 0.0
    return np.where(nonzero[:, None], vectors / np.where(nonzero, length, 1.0)[:, None], otherwise)


def nearest_bases(normals: Array) -> Array:
    """Return the bases along the axes whose normals are nearest to directions, rows, (n, 3, 3).

    Args:
        normals: Directions, shape (n, 3).
    """
    axis = np.argmax(np.abs(normals.real), axis=1)
    is_down = normals.real[np.arange(len(normals)), axis] < 0.0
    return BASES[axis, is_down.astype(np.intp)]


def framed(normal: Array, basis: Array) -> Array:
    """Rotate a basis to normals by the smallest rotation; rows of shape (n, 3, 3).

    The tangents are not unique where the normal is opposite to that of the basis.

    Args:
        normal: Normals, shape (n, 3).
        basis: Rows: normal and tangents, shape (3, 3), or one basis per normal, shape (n, 3, 3).
    """
    total = normal + basis[..., 0, :]
    square = dot(total, total) / 2.0
    is_traced = is_symbol(square.flat[0])
    is_opposite = np.zeros(len(square), np.bool_) if is_traced else square.real < _OPPOSITE
    share = dot(basis[..., 1:, :], normal[:, None])
    share = share / np.where(is_opposite, 1.0, square)[:, None]
    axes = np.empty((len(normal), 3, 3), dtype=total.dtype)
    axes[:, 0] = normal
    axes[:, 1:] = basis[..., 1:, :] - share[:, :, None] * total[:, None]
    if is_opposite.any():
        axes[is_opposite, 2] *= -1.0
    return axes
