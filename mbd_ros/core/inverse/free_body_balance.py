"""Whether the loads on a body explain its motion.

With the mass m, the mass centre c and the inertia I about the mass centre,

    sum F + m g = m (a + alpha x c + omega x (omega x c))
    sum ((r - c) x F + M) = I alpha + omega x (I omega)

in axes of the body, a the acceleration of its origin. Reactions of joints come from the whole
mechanism, the right-hand side from the links of the body alone: a load that is missing, in other
axes or in other units does not stay hidden. Source: R. Featherstone, Rigid Body Dynamics
Algorithms, 2008, sec. 2.13 to 2.15.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.inverse.free_body import BodyLoad, BodyMotion
from mbd_ros.core.state import Array


class Balance(NamedTuple):
    """What is left of the equations of a body, and the largest of their terms.

    Attributes:
        force: Left of the forces [N], shape (3,).
        moment: Left of the moments about the mass centre [N·m], shape (3,).
        largest: Force of the largest term [N]; a moment counts divided by `size`.
        size: Length that compares moments with forces: the largest arm of a load about the mass
            centre, or the radius of gyration of the body where that is more [m].
    """

    force: Array
    moment: Array
    largest: float
    size: float

    @property
    def off(self) -> float:
        """What is left as a share of the largest term [-]; 0 where nothing acts."""
        left = max(float(np.linalg.norm(self.force)), self._as_force(self.moment))
        return left / self.largest if self.largest else 0.0

    def _as_force(self, moment: Array) -> float:
        return float(np.linalg.norm(moment)) / self.size if self.size else 0.0


def inertial_load(inertia: Any, motion: BodyMotion) -> tuple[Array, Array]:
    """Weight less what the motion needs: force, and moment about the mass centre.

    Args:
        inertia: `pinocchio.Inertia` of the body.
        motion: Its motion.

    Returns:
        [N] and [N·m], shape (3,) each.
    """
    turn, spin, c = motion.angular_acceleration, motion.angular_velocity, inertia.lever
    of_centre = motion.acceleration + np.cross(turn, c) + np.cross(spin, np.cross(spin, c))
    force: Array = inertia.mass * (motion.gravity - of_centre)
    moment: Array = -inertia.inertia.dot(turn) - np.cross(spin, inertia.inertia.dot(spin))
    return force, moment


def balance(loads: Sequence[BodyLoad], inertia: Any, motion: BodyMotion) -> Balance:
    """Whether loads explain the motion of a body.

    Args:
        loads: In axes of the body.
        inertia: `pinocchio.Inertia` in the same.
        motion: In the same.
    """
    force, moment = inertial_load(inertia, motion)
    weight = inertia.mass * motion.gravity
    forces, moments, arms = [weight, force - weight], [moment], [np.zeros(3)]
    for load in loads:
        arms.append(load.point - inertia.lever)
        forces.append(load.force)
        moments += [load.moment, np.cross(arms[-1], load.force)]
    gyration = math.sqrt(max(float(np.trace(inertia.inertia)), 0.0) / inertia.mass)
    size = max(_largest(arms), gyration)
    largest = max(_largest(forces), _largest(moments) / size if size else 0.0)
    return Balance(np.sum(forces, axis=0), np.sum(moments, axis=0), largest, size)


def _largest(vectors: Sequence[Array]) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())
