"""The contract of constraints: geometry of rows, and laws of their multipliers.

With w = g'' + kd g' + kp g and the multiplier lam of a row, a law bounds lam: w = 0 inside its
bounds, w >= 0 at the lower one and w <= 0 at the upper one.
"""

import math
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Part, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Joint
from mbd_ros.core.state import Array, Mode, State

Bound = float | Sequence[float] | Callable[..., Any]
"""One number, one a row, or a function (k, x) of the state that returns one of these."""


class Level(Enum):
    """The level at which rows are equations."""

    POSITION = "position"
    VELOCITY = "velocity"  # g' = J v + rate without any g: dry friction, rolling


class Kind(Enum):
    """Kinds of multiplier laws, by the mechanism that exerts the multiplier."""

    BILATERAL = "bilateral"  # a joint, a bar: any multiplier
    BOX = "box"  # dry friction
    UNILATERAL = "unilateral"  # a stop, a gap: it only pushes
    CONE = "cone"  # a contact with friction: a normal and two tangents
    DRIVE = "drive"  # an effort


class Law(NamedTuple):
    """Law of the multipliers of some rows; the functions below build them.

    Attributes:
        kind: Kind of the law.
        lower: Smallest multiplier [N or N·m].
        upper: Largest multiplier [N or N·m].
        mu: Coefficient of friction of cones: one number, or one a contact.
        restitution: Ratio of the impulses of expansion and compression of an impact (Poisson).
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
        """Whether the rows hold with any multiplier; other rows are unilateral or bounded."""
        return self.kind is Kind.BILATERAL or (self.kind is Kind.DRIVE and self.upper == math.inf)


def bilateral() -> Law:
    """Return the law of rows that always hold, such as joints and bars."""
    return Law(Kind.BILATERAL)


def box(lower: Bound, upper: Bound) -> Law:
    """Return the law of rows that hold while lower <= lam <= upper, such as dry friction.

    Args:
        lower: Smallest multiplier [N or N·m]: one number, one a row, or a function (k, x), whose
            part declares in `reads` what it reads.
        upper: Largest multiplier, likewise.
    """
    return Law(Kind.BOX, lower, upper)


def unilateral(e: float = 0.0) -> Law:
    """Return the law of rows g >= 0 that only push, lam >= 0, such as stops.

    Args:
        e: Coefficient of restitution, 0 .. 1.
    """
    return Law(Kind.UNILATERAL, lower=0.0, restitution=e)


def cone(mu: float | Sequence[float], e: float = 0.0) -> Law:
    """Return the law of a normal and two tangents a contact: |lam_t| <= mu lam_n.

    Args:
        mu: Coefficient of friction, >= 0: one number, or one a contact.
        e: Coefficient of restitution along the normal, 0 .. 1.
    """
    return Law(Kind.CONE, mu=mu, restitution=e)


def drive(limit: float = math.inf) -> Law:
    """Return the law of rows whose multipliers are efforts of drives, |lam| <= limit."""
    return Law(Kind.DRIVE, -limit, limit)


class Row(NamedTuple):
    """One scalar equation of a constraint, as its multiplier is labelled.

    Attributes:
        name: Name of the multiplier in the part, such as `force_x`; columns put the part first.
        unit: Unit of the multiplier, such as N or N·m.
        frame: Frame in whose axes the multiplier is expressed; empty in joint space.
    """

    name: str
    unit: str
    frame: str = ""


class Stop(NamedTuple):
    """Limits within which a constraint keeps a joint.

    Attributes:
        joint: The joint.
        lower: Lower limit [rad or m], -inf without one.
        upper: Upper limit [rad or m], inf without one.
    """

    joint: Joint
    lower: float
    upper: float


class Constraint(Part):
    """Rows g(t, q) = 0 with the equation of motion M a + h = tau + J' lam.

        g' = J v + rate(t),   g'' = J a + drift

    Attributes:
        rows: One entry a row.
        level: Whether g exists; rows on velocities state g' = J v + rate alone.
        law: Law of the multipliers. A unilateral or bounded row inside its bounds has
            g'' + kd g' + kp g = 0.
        gains: kp [1/s^2] and kd [1/s] of unilateral and bounded rows, each one number or one a
            row.
        smoothed: Whether unilateral and bounded rows are solved for in every evaluation, with
            these gains, which costs the order of the method. Otherwise they are event-driven: then
            only drives follow by their gains, and inverse dynamics judges motions by them.
        driven: Joints that a law `drive` moves, one a row: inverse dynamics solves for these
            multipliers as for efforts, and they do not constrain the motion.
        stops: Joints that it keeps within limits; a motion that passes one is reported.
        slips: Whether its multipliers push along `pushes` in some mode, rather than along J'.
    """

    is_constraint = True
    rows: tuple[Row, ...]
    level: Level = Level.POSITION
    law: Law = bilateral()
    gains: tuple[float | Array, float | Array] = (0.0, 0.0)
    smoothed: bool = False
    driven: tuple[str, ...] = ()
    stops: tuple[Stop, ...] = ()
    slips: bool = False

    def acts(self, mode: Mode) -> bool:
        """Whether the rows exist in a mode; those of most constraints always do."""
        return True

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return g(t, q), shape (m,)."""
        raise NotImplementedError

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return J = dg/dq, shape (m, nv)."""
        raise NotImplementedError

    def pushes(self, k: Kinematics, x: State) -> Array:
        """Return D, with the force D' lam on the joints, shape (m, nv); J without slip."""
        return self.jacobian(k, x)

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return the part of g'' that does not depend on a, shape (m,)."""
        raise NotImplementedError

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift`, for parts where one costs less with the other."""
        return self.jacobian(k, x), self.drift(k, x)

    def rate(self, k: Kinematics, x: State) -> Array:
        """Return the part of g' that does not depend on v, shape (m,)."""
        return np.zeros(len(self.rows))

    def quick_margin(self, q: Array, v: Array, a: Array) -> float:
        """Return a cheap lower bound of w = g'' + kd g' + kp g, for the law `unilateral` only.

        Where it is >= 0 no row exerts a force, and nothing else of the constraint is evaluated.

        Args:
            q: Configuration of all joints, shape (nq,).
            v: Velocity of all joints, shape (nv,).
            a: Acceleration without the bounded rows, shape (nv,).
        """
        return -math.inf

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the wrenches of the multipliers on bodies; empty where no frame exists."""
        return ()
