"""What a contact problem is, told without the words of any package."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array

GROUND = "ground"
CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
_ZERO = (0.0, 0.0, 0.0)


class Solid(NamedTuple):
    """A free rigid body.

    Attributes:
        name: Its name.
        mass: [kg].
        shape: `sphere`, `box`, or `feet`: points below a box.
        size: Radius, or three lengths [m].
        at: Middle of the shape [m], shape (3,).
        v: Velocity of the middle [m/s], shape (3,).
        spin: Angular velocity in the world [rad/s], shape (3,).
        centre: Mass centre, from the middle [m], shape (3,).
        rpy: First attitude [rad], shape (3,).
        legs: Number of feet: below the corners, or around the largest ellipse if not four.
        is_free: Whether it moves.
    """

    name: str
    mass: float
    shape: str
    size: tuple[float, ...]
    at: tuple[float, float, float]
    v: tuple[float, float, float] = _ZERO
    spin: tuple[float, float, float] = _ZERO
    centre: tuple[float, float, float] = _ZERO
    rpy: tuple[float, float, float] = _ZERO
    legs: int = 4
    is_free: bool = True

    @property
    def moments(self) -> Array:
        """Principal moments about the mass centre, those of a homogeneous shape [kg·m^2]."""
        if self.shape == "sphere":
            return np.full(3, 0.4 * self.mass * self.size[0] ** 2)
        square = np.square(self.size)
        return self.mass / 12.0 * (square.sum() - square)

    @property
    def feet(self) -> Array:
        """Lower corners, or points of an ellipse between them, from the middle [m]."""
        angles = 2.0 * np.pi * np.arange(self.legs) / self.legs
        around = CORNERS if self.legs == 4 else np.column_stack((np.cos(angles), np.sin(angles)))
        half = 0.5 * np.array(self.size)
        return np.array([(x * half[0], y * half[1], -half[2]) for x, y in around])


class Trace(NamedTuple):
    """A run at the samples.

    Attributes:
        x: Middles of the solids that are free [m], shape (times, solids, 3).
        v: Their velocities [m/s], the same shape.
        spin: Their angular velocities in the world [rad/s], the same shape.
        forces: Normal forces at the end [N], where the problem asks for them: one a pair, or one
            a foot in their order.
    """

    x: Array
    v: Array
    spin: Array
    forces: Array


class Problem(NamedTuple):
    """What is simulated, and what is true.

    Attributes:
        name: Letters, digits and underscores.
        gravity: [m/s^2], shape (3,).
        solids: From the lowest up.
        pairs: Upper and lower solid, or `GROUND`: the half space z <= 0.
        mu: Coefficient of friction of every pair.
        restitution: Of every pair.
        times: Samples [s].
        error: Largest error of a run, in `unit`.
        unit: Of the error.
        asked: Error that this package must reach, in `unit`.
        is_smooth: Whether nothing but smooth gaps occurs, so that events can be exact.
        has_forces: Whether the error is one of forces.
    """

    name: str
    gravity: tuple[float, float, float]
    solids: tuple[Solid, ...]
    pairs: tuple[tuple[str, str], ...]
    mu: float
    restitution: float
    times: tuple[float, ...]
    error: Callable[[Trace], float]
    unit: str
    asked: float
    is_smooth: bool = True
    has_forces: bool = False


def penetration(problem: Problem, run: Trace) -> float:
    """Depth of the lowest solid in the ground at the end [m]."""
    lowest = problem.solids[0]
    rest = lowest.size[0] if lowest.shape == "sphere" else 0.5 * lowest.size[2]
    return max(0.0, rest - float(run.x[-1, 0, 2]))
