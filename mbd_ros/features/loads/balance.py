"""Whether the loads on a body explain its motion.

With the mass m, the mass centre c and the inertia I about the mass centre,

    sum F + m g = m (a + alpha x c + omega x (omega x c))
    sum ((r - c) x F + M) = I alpha + omega x (I omega)

in axes of the body, a the acceleration of its origin. Reactions of joints come from the whole
mechanism, the right-hand side from the links of the body alone: a load that is missing, in other
axes or in other units does not stay hidden. Source: R. Featherstone, Rigid Body Dynamics
Algorithms, 2008, sec. 2.13 to 2.15.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.loads.free_body import BodyLoad, BodyMotion


def balance(loads: Sequence[BodyLoad], inertia: Any, motion: BodyMotion) -> Balance:
    """Whether loads explain the motion of a body.

    Args:
        loads: In axes of the body.
        inertia: `pinocchio.Inertia` in the same.
        motion: In the same.
    """
    point, force, moment = (np.array([a[i] for a in loads]).reshape(-1, 3) for i in (2, 3, 4))
    return balances(point, force, moment, inertia, motion)


def balances(
    point: Array, force: Array, moment: Array, inertia: Any, motion: BodyMotion
) -> Balance:
    """The same of many samples.

    Args:
        point: Where loads act [m], shape (.., loads, 3).
        force: [N], shape (.., loads, 3).
        moment: About the points [N·m], shape (.., loads, 3).
        inertia: `pinocchio.Inertia` of the body.
        motion: Vectors of shape (.., 3).
    """
    inertial, twist = inertial_load(inertia, motion)
    weight = inertia.mass * motion.gravity
    arm = point - inertia.lever
    turning = np.cross(arm, force)
    gyration = math.sqrt(max(float(np.trace(inertia.inertia)), 0.0) / inertia.mass)
    size = np.maximum(_largest(arm), gyration)
    forces = [_largest(force), *(np.linalg.norm(w, axis=-1) for w in (weight, inertial - weight))]
    moments = [_largest(moment), _largest(turning), np.linalg.norm(twist, axis=-1)]
    largest = np.maximum(np.max(forces, axis=0), _ratio(np.max(moments, axis=0), size))
    left = force.sum(axis=-2) + inertial
    return Balance(left, (moment + turning).sum(axis=-2) + twist, largest, size)


class Balance(NamedTuple):
    """What is left of the equations of a body, and the largest of their terms.

    Attributes:
        force: Left of the forces [N], shape (.., 3).
        moment: Left of the moments about the mass centre [N·m], shape (.., 3).
        largest: Force of the largest term [N], shape (..); a moment counts divided by `size`.
        size: Length that compares moments with forces: the largest arm of a load about the mass
            centre, or the radius of gyration of the body where that is more [m], shape (..).
    """

    force: Array
    moment: Array
    largest: Array
    size: Array

    @property
    def off(self) -> Array:
        """What is left as a share of the largest term [-], shape (..); 0 where nothing acts."""
        turning = _ratio(np.linalg.norm(self.moment, axis=-1), self.size)
        left = np.maximum(np.linalg.norm(self.force, axis=-1), turning)
        return _ratio(left, self.largest)


def inertial_load(inertia: Any, motion: BodyMotion) -> tuple[Array, Array]:
    """Weight less what the motion needs: force, and moment about the mass centre.

    Args:
        inertia: With `mass`, `lever` and `inertia`, as `pinocchio.Inertia` of the body.
        motion: Its motion, vectors of shape (.., 3).

    Returns:
        [N] and [N·m], shape (.., 3) each.
    """
    turn, spin, c = motion.angular_acceleration, motion.angular_velocity, inertia.lever
    of_centre = motion.acceleration + np.cross(turn, c) + np.cross(spin, np.cross(spin, c))
    force: Array = inertia.mass * (motion.gravity - of_centre)
    moment: Array = -turn @ inertia.inertia - np.cross(spin, spin @ inertia.inertia)
    return force, moment


def _largest(vectors: Array) -> Array:
    largest: Array = np.linalg.norm(vectors, axis=-1).max(axis=-1, initial=0.0)
    return largest


def _ratio(part: Array, whole: Array) -> Array:
    """The quotient, 0 where the whole is 0."""
    part, whole = np.asarray(part), np.asarray(whole)
    ratio: Array = np.divide(part, whole, out=np.zeros(np.shape(part)), where=whole != 0.0)
    return ratio
