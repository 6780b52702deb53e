"""Features of one body over one shape of another: gaps, contact frames and their derivatives.

One body moves and the other is at rest: all vectors stand in the axes of the shape at rest, V is
the velocity of the moving body in them. With the lever rho from the origin of the moving body to
the contact point, and an axis e of the contact frame,

    w = e . u,   u = v + omega x rho,   w' = e . (a + alpha x rho + omega x rho') + e' . u

Source: J. Trinkle, J.-S. Pang, S. Sudarsky, G. Lo, On dynamic multi-rigid-body contact problems
with Coulomb friction, ZAMM 77, 1997, for rows of contacts; F. Pfeiffer, C. Glocker, Multibody
Dynamics with Unilateral Contacts, 1996, ch. 4, for their derivatives.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.pair_motion import PairMotion, Placed
from mbd_ros.core.model.points import Pair
from mbd_ros.core.state import Array

_ALL = slice(0, 6)


class Touch(NamedTuple):
    """Where features touch, at one pose.

    Attributes:
        lever: From the origin of the moving body to the contact points [m], shape (n, 3).
        axes: Normal out of the shape at rest, then both tangents, shape (n, 3, 3), rows.
    """

    lever: Array
    axes: Array


class Turning(NamedTuple):
    """How contact points and frames move.

    Attributes:
        lever: Derivative of the lever [m/s], shape (n, 3).
        normal: Derivative of the normal [1/s], shape (n, 3).
        spin: Rate of the tangents about the normal [rad/s], shape (n,).
    """

    lever: Array
    normal: Array
    spin: Array


class Meeting:
    """What the features of two shapes have in common.

    Args:
        pair: The shape at rest, as the observer, and the moving body.
        features: Names, one a feature.

    Attributes:
        pair: As given.
        features: As given.
        reach: How far points of the moving body that may touch are from its origin, the second
            point of the pair, at most [m]; inf where nobody knows.
    """

    reach: float = math.inf

    def __init__(self, pair: Pair, features: tuple[str, ...]) -> None:
        self.pair, self.features = pair, features

    def gaps(self, seen: PairMotion) -> Array:
        """Distances of the surfaces, negative where they overlap [m], shape (n,)."""
        raise NotImplementedError

    def touch(self, pose: Any) -> Touch:
        """Contact points and frames at a pose of the moving body."""
        raise NotImplementedError

    def turning(self, pose: Any, touch: Touch, velocity: Any) -> Turning:
        """Their derivatives, for the velocity of the moving body, a `pinocchio.Motion`."""
        raise NotImplementedError

    def jacobian(self, seen: PairMotion, placed: Placed | None) -> Array:
        """From joint velocities to those of the features, shape (3 n, nv)."""
        lever, axes = self.touch(seen.pose())
        rows = np.concatenate((axes, crossed(lever[:, None], axes)), axis=2)
        jacobian: Array = rows.reshape(-1, 6).dot(seen.jacobian(placed, _ALL))
        return jacobian

    def drift(self, seen: PairMotion, placed: Placed) -> Array:
        """J' v, shape (3 n,)."""
        velocity, rate = seen.spatial(placed)
        pose = seen.pose()
        touch = self.touch(pose)
        (lever, axes), turning = touch, self.turning(pose, touch, velocity)
        omega = velocity.angular
        slip = velocity.linear + crossed(omega, lever)
        a = pin.classicAcceleration(velocity, rate)
        a = a + crossed(rate.angular, lever) + crossed(omega, turning.lever)
        seen_slip = np.einsum("nij,nj->ni", axes, slip)
        normal, x, y = seen_slip.T
        change = np.einsum("nij,nj->ni", axes, turning.normal)[:, 1:]
        w = np.einsum("nij,nj->ni", axes, a)
        w[:, 0] += np.einsum("nj,nj->n", turning.normal, slip)
        w[:, 1] += turning.spin * y - change[:, 0] * normal
        w[:, 2] -= turning.spin * x + change[:, 1] * normal
        return w.ravel()


def crossed(a: Array, b: Array) -> Array:
    """Cross product a x b along the last axis, many times faster than numpy's for few of them."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)
