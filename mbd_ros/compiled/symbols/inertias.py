"""Mass distributions, and the part of one that its joint cannot move.

That part is given to the parent: a distribution on the axis of a revolute joint, the inertia
tensor beyond a prismatic one. The equations of motion stay the same. Source: W. Khalil, E. Dombre,
Modeling, Identification and Control of Robots, 2002, ch. 9.
"""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array

REVOLUTE, PRISMATIC, FREE = "revolute", "prismatic", "free"
_SNAP = 1.0e-15  # rounding of products of rotations


class Inertia(NamedTuple):
    """Mass distribution about the origin of a link, in its axes.

    Attributes:
        m: Mass [kg].
        h: Mass times mass centre [kg·m], shape (3,).
        I: Inertia about the origin [kg·m^2], shape (3, 3).
    """

    m: Any
    h: Any
    I: Any  # noqa: E741

    def plus(self, other: "Inertia") -> "Inertia":
        """Both together."""
        return Inertia(self.m + other.m, self.h + other.h, self.I + other.I)

    def seen_from(self, R: Array, p: Array) -> "Inertia":
        """In the axes of another link.

        Args:
            R: From these axes to the other ones, shape (3, 3).
            p: This origin in the other axes [m], shape (3,).
        """
        h, P = R @ self.h, skew(p)
        H = skew(h)
        moved = R @ self.I @ R.T - H @ P - P @ H - self.m * (P @ P)
        return Inertia(self.m, h + self.m * p, moved)


def split(kind: str, inertia: Inertia) -> tuple[Inertia, Inertia]:
    """What a link keeps, and what its joint cannot move, which its parent may have."""
    nothing = np.zeros(3), np.zeros((3, 3))
    if kind == FREE:
        return inertia, Inertia(0.0, *nothing)
    if kind == PRISMATIC:
        return inertia._replace(I=nothing[1]), Inertia(0.0, nothing[0], inertia.I)
    along = 0.5 * (inertia.I[0, 0] + inertia.I[1, 1] - inertia.I[2, 2])
    h = inertia.h * np.array((0.0, 0.0, 1.0))
    given = Inertia(inertia.m, h, np.diag((along, along, 0.0)))
    return Inertia(0.0, inertia.h - h, inertia.I - given.I), given


def clean(inertia: Inertia) -> Inertia:
    """Without what is rounding beside the rest."""
    h, about = inertia.h, inertia.I
    size = float(np.abs(about).max())
    moment = max(float(np.abs(h).max()), float(np.sqrt(abs(inertia.m) * size)))
    h = np.where(np.abs(h) <= _SNAP * moment, 0.0, h)
    return Inertia(inertia.m, h, np.where(np.abs(about) <= _SNAP * size, 0.0, about))


def skew(v: Array) -> Array:
    """The matrix of v x, shape (3, 3)."""
    x, y, z = v
    return np.array(((0.0 * x, -z, y), (z, 0.0 * x, -x), (-y, x, 0.0 * x)))
