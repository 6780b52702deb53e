"""Rows that give way in a step of velocities: stops, dry friction, limited drives."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.bounded_impulses import BoundedImpulses
from mbd_ros.core.complementarity.unilateral_impulses import PushImpulses
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array
from mbd_ros.core.time_stepping.step_problem import StepProblem
from mbd_ros.core.time_stepping.unilateral_rows import Slots, Which


class GivingWay:
    """One complementarity problem a step for all rows that give way.

    Args:
        rows: The rows; their bounds are those of the state that was last asked for.

    Attributes:
        last: What the next problem begins with; empty where it begins with nothing.
        shared: Which rows `last` is of and what their A was, if it is of least norm; else empty.
        worst: The largest residuals of contacts since `forget`; None without contacts.
        forces: Mean forces of contacts in the last step; None without contacts.
    """

    def __init__(self, rows: ConstraintRows) -> None:
        self._rows, self.last = rows, np.zeros(0)
        self.shared: tuple[Any, ...] = ()
        self.worst: Any = None
        self.forces: Array | None = None

    def forget(self) -> None:
        """Begin to look for the largest residuals anew."""

    def turned(self, problem: StepProblem, end: Array) -> Slots | None:
        """Tangents of contacts whose slips end within the step; without contacts None."""
        return None

    def ending(self, turned: Slots, problem: StepProblem, end: Array) -> float:
        """When the first of some slips ends [s]."""
        return 0.0

    def accept(self) -> None:
        """Go on from the step that `turned` looked at."""

    def given_back(self, problem: StepProblem, end: Array) -> Array | None:
        """What is taken from the way of the step [m, rad], shape (nv,); without contacts None."""
        return None

    def end(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Velocity at the end of the step, from that without rows that give way.

        Args:
            problem: The problem.
            closed: One-sided rows that may push.
            free: The velocity without rows that give way.
            near: The same velocity, as it was before forces on the way to it were known.
        """
        if not len(closed):
            return free + 0.0
        return self.pushed(problem, closed, free, near)

    def pushed(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Velocity at the end of the step if no other rows push; arguments as for `end`."""
        on = np.flatnonzero((closed | ~problem.acting.pushes)[problem.acting.decides])
        return free + self._change(problem, on, free)

    def _change(self, problem: StepProblem, on: NDArray[np.intp], free: Array) -> Array:
        """What the impulses of some rows add to a velocity.

        Args:
            problem: The problem.
            on: The rows.
            free: The velocity without them.
        """
        if not len(on):
            return np.zeros(len(free))
        response, acting = problem.response, problem.acting
        of = response.A[np.ix_(on, on)], response.loose[on], [acting.names[i] for i in on]
        b, speed = problem.asked(on, free), problem.speed(free)
        if acting.pushes[on].all():
            p = PushImpulses(response.G[:, on], *of[1:]).solve(b, speed)
        else:
            p = BoundedImpulses(*of).solve(b, *self._bounds(problem, acting.at[on]), speed)
        change: Array = response.X[:, on].dot(p)
        return change

    def _bounds(self, problem: StepProblem, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Smallest and largest impulses of rows in a step."""
        return problem.h * self._rows.lower[at], problem.h * self._rows.upper[at]
