"""What rows hold, and what their multipliers may be.

With w = g'' + kd g' + kp g and the multiplier lam of a row, a law bounds lam: w = 0 inside its
bounds, w >= 0 at the lower one and w <= 0 at the upper one.
"""

import math
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, NamedTuple

Bound = float | Sequence[float] | Callable[..., Any]
"""One number, one a row, or a function (k, x) of the state that gives one of these."""


class Level(Enum):
    """What rows are equations of."""

    POSITION = "position"
    VELOCITY = "velocity"  # no g exists, g' = J v + rate alone: dry friction, rolling


class Kind(Enum):
    """What exerts a multiplier, as inverse dynamics needs to know."""

    BILATERAL = "bilateral"  # a joint, a bar: whatever the row takes
    BOX = "box"  # dry friction
    UNILATERAL = "unilateral"  # a stop, a gap: it only pushes
    CONE = "cone"  # a contact with friction: a normal and two tangents
    DRIVE = "drive"  # an effort


class Law(NamedTuple):
    """Law of the multipliers of some rows; made by the functions below.

    Attributes:
        kind: What exerts them.
        lower: Smallest multiplier [N or N·m].
        upper: Largest multiplier [N or N·m].
        mu: Coefficient of friction of cones: one number, or one a contact.
        restitution: Share of the impulse of compression that an impact gives back (Poisson).
    """

    kind: Kind
    lower: Bound = -math.inf
    upper: Bound = math.inf
    mu: float | Sequence[float] = 0.0
    restitution: float = 0.0

    @property
    def varies(self) -> bool:
        """Whether bounds depend on the state."""
        return callable(self.lower) or callable(self.upper)

    @property
    def is_rigid(self) -> bool:
        """Whether the rows hold whatever multipliers that takes; other rows give way."""
        return self.kind is Kind.BILATERAL or (self.kind is Kind.DRIVE and self.upper == math.inf)


def bilateral() -> Law:
    """Rows that hold, as joints and bars do."""
    return Law(Kind.BILATERAL)


def box(lower: Bound, upper: Bound) -> Law:
    """Rows that hold while lower <= lam <= upper [N or N·m], as dry friction does.

    Args:
        lower: One number, one a row, or a function (k, x); a part that gives one says in `reads`
            what it reads.
        upper: The same.
    """
    return Law(Kind.BOX, lower, upper)


def unilateral(e: float = 0.0) -> Law:
    """Rows g >= 0 that only push, lam >= 0, as stops do.

    Args:
        e: Restitution, 0 .. 1.
    """
    return Law(Kind.UNILATERAL, lower=0.0, restitution=e)


def cone(mu: float | Sequence[float], e: float = 0.0) -> Law:
    """Three rows a contact, a normal and two tangents: lam_n >= 0, |lam_t| <= mu lam_n.

    Args:
        mu: Coefficient of friction, >= 0: one number, or one a contact.
        e: Restitution along the normal, 0 .. 1.
    """
    return Law(Kind.CONE, mu=mu, restitution=e)


def drive(limit: float = math.inf) -> Law:
    """Rows whose multipliers are efforts of drives, |lam| <= limit [N or N·m]."""
    return Law(Kind.DRIVE, -limit, limit)
