"""What a step of velocities has to solve, and which of its rows close on the way.

With constant accelerations a gap goes gap + rate t + bent t^2 / 2.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.impulse_response import ImpulseResponse
from mbd_ros.core.state import Array, State
from mbd_ros.core.time_stepping.implicit_loads import Slopes
from mbd_ros.core.time_stepping.unilateral_rows import Acting, Which

_SLIGHT = 1.0e-12  # a rate that is none, of the largest velocity
_ROUNDING = 1.0e-9  # the same of rows between which nothing else moves


class StepProblem(NamedTuple):
    """The linear problem of a step.

    Attributes:
        x: State of all joints at its intermediate time, with the velocity of the start.
        M: Their mass matrix there.
        response: To impulses of the rows that give way.
        acting: Which rows these are.
        J: Their Jacobian, shape (m, nv).
        gap: Their g at the start of the step, shape (m,).
        rate: Their g' with the velocity of the start, shape (m,).
        offset: Their g' at the end of the step, without J v, shape (m,).
        bend: What of that comes from the change of J, shape (m,).
        goal: J v of the bilateral rows at the end of the step.
        free: Velocity at the end without rows that give way, shape (nv,).
        h: Length of the step [s].
        theta: Share of the velocity at its end in the mean one.
        slopes: Of loads and internal states.
        dz_still: Increment of internal states if the velocity at the end is 0, shape (nz,).
    """

    x: State
    M: Array
    response: ImpulseResponse
    acting: Acting
    J: Array
    gap: Array
    rate: Array
    offset: Array
    bend: Array
    goal: Array
    free: Array
    h: float
    theta: float
    slopes: Slopes
    dz_still: Array

    def dz(self, end: Array) -> Array:
        """Increment of internal states with a velocity at the end, shape (nz,)."""
        increment: Array = self.dz_still + self.slopes.by_v.dot(end)
        return increment

    @property
    def left(self) -> Array:
        """Gaps at the end of the step if the rates became 0 by then, shape (m,)."""
        return self.gap + self.h * (1.0 - self.theta) * self.rate

    @property
    def at_end(self) -> Array:
        """The g' at the end of the step without rows that give way, shape (m,)."""
        return self.J.dot(self.free) + self.offset

    def closed(self) -> Which:
        """One-sided rows that would be closed at the end of the step."""
        if not len(self.gap):
            return self.acting.pushes
        return self.acting.pushes & (self.left + self.h * self.theta * self.at_end <= 0.0)

    def hits(self, closed: Which) -> Which:
        """Closed rows that approach faster than the forces of one step make them."""
        if not len(closed):
            return closed
        if not (closed & (self.rate < 0.0)).any():
            return np.zeros(len(closed), dtype=np.bool_)
        gained = np.abs(self.at_end - self.rate)
        speed = max(self.speed(self.x.v), self.speed(self.free))
        slow = _ROUNDING * speed * np.sqrt(np.maximum(self.response.loose, 0.0))
        return closed & (-self.rate > np.maximum(gained, slow))

    def passed(self, end: Array) -> Which:
        """One-sided rows that a velocity at the end of the step would take beyond 0."""
        left = self.left + self.h * self.theta * (self.J.dot(end) + self.offset)
        return self.acting.pushes & (left < -self.h * self.slight(self.free))

    def asked(self, on: NDArray[np.intp], free: Array) -> Array:
        """The g' of some rows at the end of the step, less what they may keep, shape (len(on),).

        Args:
            on: The rows.
            free: Velocity at the end without rows that give way.
        """
        return self.J[on].dot(free) + self.offset[on] + self.rates_left(on)

    def speed(self, v: Array) -> float:
        """A velocity in the mass metric."""
        return max(float(v.dot(self.M).dot(v)), 0.0) ** 0.5

    def slight(self, v: Array) -> Array:
        """Rates of the rows that are none beside a velocity, shape (m,)."""
        none: Array = _SLIGHT * self.speed(v) * np.sqrt(np.maximum(self.response.loose, 0.0))
        return none

    def rates_left(self, on: NDArray[np.intp]) -> Array:
        """The g' that rows may keep, since gaps are left at the end, shape (len(on),)."""
        room = np.maximum(self.left[on], 0.0) / (self.h * self.theta)
        return np.where(self.acting.pushes[on], room, 0.0)


def first_closing(gap: Array, rate: Array, bent: Array) -> float:
    """The first time at which a gap is 0 [s], rates negative; 0 where one has no room left."""
    root = np.sqrt(np.maximum(rate * rate - 2.0 * bent * gap, 0.0))
    return max(float((2.0 * gap / (root - rate)).min()), 0.0)
