"""Rows that give way in a step of velocities: stops, dry friction, limited drives, a contact."""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.step_problem import StepProblem, Which
from mbd_ros.core.optimization.bounded_impulses import BoundedImpulses
from mbd_ros.core.optimization.contact_problem import ContactProblem
from mbd_ros.core.optimization.push_impulses import PushImpulses
from mbd_ros.core.row_laws import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_layout import Cone
from mbd_ros.core.state import Array

_SLIPS = 1.0e-12  # of the square of a slip: it neither ends in the step nor turns round


class GivingWay:
    """One complementarity problem a step for all rows that give way.

    Args:
        rows: The rows; their bounds are those of the state that was last asked for.
        theta: Share of the velocity at the end of a step in the mean one.

    Attributes:
        pushes: Which rows are one-sided, the normal of a contact among them, shape (m,).
    """

    def __init__(self, rows: ConstraintRows, theta: float) -> None:
        self._rows, self._theta = rows, theta
        self._names = [row.name for row in rows.rows]
        self.pushes, self._is_friction, self._cone = _one_sided(rows)

    def end(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Velocity at the end of the step, from that without rows that give way.

        Args:
            problem: The problem.
            closed: One-sided rows that may push.
            free: The velocity without rows that give way.
            near: A velocity that tells whether a contact slips; then its friction is against the
                mean slip of the step, which is of second order where slip turns.
        """
        acts = closed | ~(self.pushes | self._is_friction)
        if self._cone is None or not closed[self._cone.slots.start]:
            return free + self._impulses(problem, np.flatnonzero(acts), free, None)
        acts[self._cone.slots] = True
        on = np.flatnonzero(acts)
        first = int(np.searchsorted(on, self._cone.slots.start))
        cone = self._cone._replace(slots=slice(first, first + 3))
        if near is not None:
            slip, before = (self._slip(problem, v) for v in (near, problem.x.v))
            late = (1.0 - self._theta) / self._theta * before
            end = free + self._impulses(problem, on, free, cone, late)
            mean = self._slip(problem, end) + late
            if min(slip.dot(mean), before.dot(mean)) > _SLIPS * before.dot(before):
                return end
        return free + self._impulses(problem, on, free, cone)

    def _slip(self, problem: StepProblem, v: Array) -> Array:
        """Velocity of the contact along its plane at the end of the step, shape (2,)."""
        assert self._cone is not None
        at = slice(self._cone.slots.start + 1, self._cone.slots.stop)
        slip: Array = problem.J[at].dot(v) + problem.offset[at]
        return slip

    def _impulses(
        self,
        problem: StepProblem,
        on: NDArray[np.intp],
        free: Array,
        cone: Cone | None,
        late: Array | None = None,
    ) -> Array:
        """What the impulses of some rows, perhaps a contact among them, add to a velocity.

        Args:
            problem: The problem.
            on: The rows.
            free: The velocity without them.
            cone: The contact, by places in `on`.
            late: What its slip has more than at the end of the step, shape (2,).
        """
        if not len(on):
            return np.zeros(len(free))
        response, h = problem.response, problem.h
        of = response.A[np.ix_(on, on)], response.loose[on], [self._names[i] for i in on]
        speed = max(float(free.dot(problem.M).dot(free)), 0.0) ** 0.5
        b = problem.J[on].dot(free) + problem.offset[on] + problem.rates_left(on)
        lower = np.where(self.pushes, 0.0, h * self._rows.lower)[on]
        upper = h * self._rows.upper[on]
        if cone is None and self.pushes[on].all():
            p = PushImpulses(response.G[:, on], *of[1:]).solve(b, speed)
        elif cone is None:
            p = BoundedImpulses(*of).solve(b, lower, upper, speed)
        else:
            if late is not None:
                b[cone.slots.start + 1 : cone.slots.stop] += late
            p = ContactProblem(*of, [cone]).solve(b, lower, upper, speed)
        change: Array = response.X[:, on].dot(p)
        return change


def _one_sided(rows: ConstraintRows) -> tuple[Which, Which, Cone | None]:
    """Rows that only push, those of friction at a contact, and the contact."""
    pushes, is_friction = np.zeros((2, len(rows.rows)), dtype=np.bool_)
    for block, mine in zip(rows.blocks, rows.slices, strict=True):
        if block.law.kind is Kind.UNILATERAL:
            pushes[mine] = True
        elif block.law.kind is Kind.CONE:
            is_friction[mine] = True
            normals = slice(mine.start, mine.stop, 3)
            pushes[normals], is_friction[normals] = True, False
    return pushes, is_friction, next(iter(rows.cones), None)
