"""The contract of constraints: geometry, and what their multipliers may be.

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


class Row(NamedTuple):
    """One scalar equation of a constraint, for readers of its multiplier.

    Attributes:
        name: Of the multiplier in the part, such as `force_x`; columns put that of the part first.
        unit: Unit of the multiplier: N, N·m, ..
        frame: Frame in whose axes the multiplier stands; empty in joint space.
    """

    name: str
    unit: str
    frame: str = ""


class Stop(NamedTuple):
    """Ends that a constraint keeps a joint within.

    Attributes:
        lower: Lower end [rad or m], -inf without one.
        upper: Upper end [rad or m], inf without one.
    """

    joint: Joint
    lower: float
    upper: float


class Constraint(Part):
    """Geometry of rows g(t, q) = 0 with the equation of motion M a + h = tau + J' lam.

        g' = J v + rate(t),   g'' = J a + drift

    Attributes:
        rows: One entry a row.
        level: Whether g exists; rows of velocities state g' = J v + rate alone.
        law: What the multipliers may be; a row that gives way holds g'' + kd g' + kp g = 0.
        gains: kp [1/s^2] and kd [1/s] of rows that give way, each one number or one a row.
        smoothed: Whether rows that give way are solved for in every evaluation, with these gains,
            which costs the order of the method. Otherwise they are exact, from event to event:
            only drives follow by their gains then, and inverse dynamics judges motions by them.
        driven: Joints that a law `drive` moves, one a row: inverse dynamics asks for these
            multipliers as for efforts, and they demand nothing of the motion.
        stops: Joints that it keeps within ends; a motion that passes one is reported.
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
        """Whether the rows are on in a mode; those of most constraints always are."""
        return True

    def residual(self, k: Kinematics, x: State) -> Array:
        """g(t, q), shape (m,)."""
        raise NotImplementedError

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """J = dg/dq, shape (m, nv)."""
        raise NotImplementedError

    def pushes(self, k: Kinematics, x: State) -> Array:
        """D, with the force D' lam on the joints, shape (m, nv); J while nothing slips."""
        return self.jacobian(k, x)

    def drift(self, k: Kinematics, x: State) -> Array:
        """The part of g'' without the acceleration, J' v included, shape (m,)."""
        raise NotImplementedError

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`; for parts where one costs less with the other."""
        return self.jacobian(k, x), self.drift(k, x)

    def rate(self, k: Kinematics, x: State) -> Array:
        """The part of g' without the velocity, shape (m,)."""
        return np.zeros(len(self.rows))

    def quick_margin(self, q: Array, v: Array, a: Array) -> float:
        """A cheap lower bound of w = g'' + kd g' + kp g; for the law `unilateral` only.

        No row acts where it is >= 0; then nothing else of the constraint is evaluated.

        Args:
            a: Acceleration without the bounded rows, shape (nv,).
        """
        return -math.inf

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Wrenches of the multipliers, shape (m,), on bodies; empty where no frame exists."""
        return ()
