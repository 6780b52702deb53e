"""Features of one body over one shape of another: gaps, contact frames and their derivatives.

One body moves and the other is at rest: all vectors stand in the axes of the shape at rest. With
the lever rho from the origin of the moving body to the contact point, and an axis e of the contact
frame,

    w = e . u,   u = v + omega x rho,   w' = e . (a + alpha x rho + omega x rho') + e' . u

Source: F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts, 1996, ch. 4. The
derivatives rho' and e' along the motion are those of `PairMotion.along`.
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
    """What the features of two shapes have in common.

    Args:
        pair: The shape at rest, as the observer, and the moving body.
        features: Names, one a feature.

    Attributes:
        reach: How far points of the moving body that may touch are from its origin, the second
            point of the pair, at most [m].
        why_not: Why its gaps are not twice differentiable; empty where they are.
    """

    reach: float = math.inf
    why_not: str = ""

    def __init__(self, pair: Pair, features: tuple[str, ...]) -> None:
        self.pair = pair
        self.features = features

    def touch(self, pose: Any) -> Touch:
        """Gaps, contact points and frames at a `Pose` of real, complex or symbolic numbers."""
        raise NotImplementedError

    def gaps(self, seen: PairMotion) -> Array:
        """Distances of the surfaces, negative where they overlap [m], shape (n,)."""
        return self.touch(seen.pose()).gap

    def room(self, seen: PairMotion, gaps: Array) -> float:
        """How far the bodies are from touching at least [m], for the gaps there."""
        return float(gaps.min())

    def jacobian(self, seen: PairMotion) -> Array:
        """From joint velocities to those of the features, shape (3 n, nv)."""
        _, lever, axes = self.touch(seen.pose())
        return _rows(lever, axes).dot(seen.jacobian(seen.placed(), _ALL))

    def drift(self, seen: PairMotion) -> Array:
        """J' v, shape (3 n,), in frames that do not spin about their normals.

        Friction is isotropic. Tangents between balls are turned from axes of one of them and would
        spin without bounds where the normal is opposite to the one that they are turned from.
        """
        return self.accelerations(seen)[1]

    def accelerations(self, seen: PairMotion) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, for the contact points and frames of one."""
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
    """From the velocity of the moving body to those of its features, shape (3 n, 6)."""
    rows: Array = np.concatenate((axes, cross(lever[:, None], axes)), axis=2).reshape(-1, 6)
    return rows


def _unspun(axes: Array, rate: Array) -> Array:
    """Rates of axes without the spin about the normal, which is the first, shape (n, 3, 3)."""
    spin = np.einsum("nj,nj->n", rate[:, 1], axes[:, 2])[:, None]
    tangents = rate[:, 1] - spin * axes[:, 2], rate[:, 2] + spin * axes[:, 1]
    return np.stack((rate[:, 0], *tangents), axis=1)


class Touch(NamedTuple):
    """Where features touch, at one pose.

    Attributes:
        gap: Distances of the surfaces, negative where they overlap [m], shape (n,).
        lever: From the origin of the moving body to the contact points [m], shape (n, 3).
        axes: Normal out of the shape at rest, then both tangents, shape (n, 3, 3), rows.
    """

    gap: Array
    lever: Array
    axes: Array


def directions(vectors: Array, length: Array, otherwise: Array) -> Array:
    """Rows of length 1, shape (n, 3).

    Args:
        vectors: Shape (n, 3).
        length: Their lengths, shape (n,).
        otherwise: Direction of those without length, shape (3,) or (n, 3).
    """
    if is_symbol(length.flat[0]):  # where two points meet, expressions have no direction
        symbolic: Array = vectors / length[:, None]
        return symbolic
    some = length.real > 0.0
    return np.where(some[:, None], vectors / np.where(some, length, 1.0)[:, None], otherwise)


def nearest_bases(normals: Array) -> Array:
    """The bases along axes whose normals are nearest to directions, shape (n, 3, 3), rows.

    Args:
        normals: Any directions, shape (n, 3).
    """
    axis = np.argmax(np.abs(normals.real), axis=1)
    is_down = normals.real[np.arange(len(normals)), axis] < 0.0
    return BASES[axis, is_down.astype(np.intp)]


def framed(normal: Array, basis: Array) -> Array:
    """Normals and tangents, the basis turned by the smallest rotation, shape (n, 3, 3), rows.

    Opposite to the normal of the basis tangents have no direction of their own.

    Args:
        normal: Shape (n, 3).
        basis: Normal and tangents, rows, shape (3, 3), or one each, shape (n, 3, 3).
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
