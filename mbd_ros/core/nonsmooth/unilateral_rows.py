"""Unilateral and bounded rows in a step of Moreau and Jean: stops, dry friction, limited drives.

`StepProblem` is the linear problem of a step. In it the rows have the rates

    w = J v+ + offset,   v+ = free + K^-1 J' p

at the end of the step, and impulses p that push or stay within h times their bounds. A unilateral
row is active where its gap would close: with constant accelerations it ends at

    gap + h ((1 - theta) rate + theta w)

and an active row may keep the rate that its remaining gap allows. `UnilateralSolver` solves for
the impulses; `contact_step` solves for contacts with friction.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.bounded_rows import BoundedImpulses, PushImpulses
from mbd_ros.core.dynamics.mechanism import ImpulseResponse, Mechanism
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.nonsmooth.implicit_loads import Slopes
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import Cone, ConstraintRows
from mbd_ros.core.state import Array, State

Which = NDArray[np.bool_]
Slots = NDArray[np.intp]
_SLIGHT = 1.0e-12  # a rate that is none, of the largest velocity
_ROUNDING = 1.0e-9  # the same of rows between which nothing else moves


class StepProblem(NamedTuple):
    """The linear problem of a step.

    Attributes:
        x: State of all joints at its intermediate time, with the velocity of the start.
        M: Their mass matrix there.
        response: To impulses of the rows that give way.
        row_set: Which rows these are.
        J: Their Jacobian, shape (m, nv).
        gap: Their g at the start of the step, shape (m,).
        rate: Their g' with the velocity of the start, shape (m,).
        offset: Their g' at the end of the step, without J v, shape (m,).
        bend: What of that comes from the change of J, shape (m,).
        goal: J v of the bilateral rows at the end of the step.
        free: Velocity at the end without unilateral and bounded rows, shape (nv,).
        h: Length of the step [s].
        theta: Share of the velocity at its end in the mean one.
        slopes: Of loads and internal states.
        dz_still: Increment of internal states if the velocity at the end is 0, shape (nz,).
    """

    x: State
    M: Array
    response: ImpulseResponse
    row_set: RowSet
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
        """Return the increment of internal states with a velocity at the end, shape (nz,)."""
        increment: Array = self.dz_still + self.slopes.by_v.dot(end)
        return increment

    @property
    def left(self) -> Array:
        """Gaps at the end of the step if the rates became 0 by then, shape (m,)."""
        return self.gap + self.h * (1.0 - self.theta) * self.rate

    @property
    def at_end(self) -> Array:
        """The g' at the end of the step without unilateral and bounded rows, shape (m,)."""
        return self.J.dot(self.free) + self.offset

    def closed(self) -> Which:
        """Return the unilateral rows that would be closed at the end of the step."""
        if not len(self.gap):
            return self.row_set.pushes
        return self.row_set.pushes & (self.left + self.h * self.theta * self.at_end <= 0.0)

    def hits(self, closed: Which) -> Which:
        """Return closed rows that approach faster than the forces of one step make them."""
        if not len(closed):
            return closed
        if not (closed & (self.rate < 0.0)).any():
            return np.zeros(len(closed), dtype=np.bool_)
        gained = np.abs(self.at_end - self.rate)
        speed = max(self.speed(self.x.v), self.speed(self.free))
        slow = _ROUNDING * speed * np.sqrt(np.maximum(self.response.loose, 0.0))
        return closed & (-self.rate > np.maximum(gained, slow))

    def passed(self, end: Array) -> Which:
        """Return the unilateral rows whose gaps a velocity at the end would make negative."""
        left = self.left + self.h * self.theta * (self.J.dot(end) + self.offset)
        return self.row_set.pushes & (left < -self.h * self.slight(self.free))

    def required_rates(self, on: NDArray[np.intp], free: Array) -> Array:
        """Return g' of some rows at the end of the step, less what they may keep, shape (k,).

        Args:
            on: Numbers of the rows, shape (k,).
            free: Velocity at the end without rows that give way.
        """
        return self.J[on].dot(free) + self.offset[on] + self.rates_left(on)

    def speed(self, v: Array) -> float:
        """Return a velocity in the mass metric."""
        return max(float(v.dot(self.M).dot(v)), 0.0) ** 0.5

    def slight(self, v: Array) -> Array:
        """Return rates of the rows that are none beside a velocity, shape (m,)."""
        none: Array = _SLIGHT * self.speed(v) * np.sqrt(np.maximum(self.response.loose, 0.0))
        return none

    def rates_left(self, on: NDArray[np.intp]) -> Array:
        """Return g' that rows may keep, since gaps are left at the end, shape (len(on),)."""
        room = np.maximum(self.left[on], 0.0) / (self.h * self.theta)
        return np.where(self.row_set.pushes[on], room, 0.0)


class UnilateralSolver:
    """One complementarity problem a step for all rows that give way.

    Args:
        rows: The rows, with the bounds of their last state.

    Attributes:
        last: Impulses with which the next problem begins; empty for none.
        shared: The rows of `last` and their matrix A, if `last` has the least norm; else empty.
        worst: The largest residuals of contacts since `reset_residuals`; None without contacts.
        forces: Mean forces of contacts in the last step; None without contacts.
    """

    def __init__(self, rows: ConstraintRows) -> None:
        self._rows = rows
        self.last = np.zeros(0)
        self.shared: tuple[Any, ...] = ()
        self.worst: Any = None
        self.forces: Array | None = None

    def reset_residuals(self) -> None:
        """Set the largest residuals to 0."""

    def early_slips(self, problem: StepProblem, end: Array) -> Slots | None:
        """Return tangents of contacts whose slips end within the step; without contacts None."""
        return None

    def first_slip_end(self, slips: Slots, problem: StepProblem, end: Array) -> float:
        """Return when the first of some slips ends [s]."""
        return 0.0

    def accept(self) -> None:
        """Accept the step that `early_slips` has searched."""

    def displacement_correction(self, problem: StepProblem, end: Array) -> Array | None:
        """Return the correction of the displacement [m, rad]; None without contacts."""
        return None

    def solve(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Return the velocity at the end of the step, from that without rows that give way.

        Args:
            closed: One-sided rows that may push.
            free: The velocity without rows that give way.
            near: The same velocity, as it was before forces on the way to it were known.
        """
        if not len(closed):
            return free + 0.0
        return self.solve_active(problem, closed, free, near)

    def solve_active(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Velocity at the end of the step if no other rows push; arguments as for `end`."""
        on = np.flatnonzero((closed | ~problem.row_set.pushes)[problem.row_set.decides])
        return free + self._change(problem, on, free)

    def _change(self, problem: StepProblem, on: NDArray[np.intp], free: Array) -> Array:
        """Return what the impulses of some rows add to a velocity.

        Args:
            free: The velocity without them.
        """
        if not len(on):
            return np.zeros(len(free))
        response, row_set = problem.response, problem.row_set
        of = response.A[np.ix_(on, on)], response.loose[on], [row_set.names[i] for i in on]
        b, speed = problem.required_rates(on, free), problem.speed(free)
        if row_set.pushes[on].all():
            p = PushImpulses(response.G[:, on], *of[1:]).solve(b, speed)
        else:
            p = BoundedImpulses(*of).solve(b, *self._bounds(problem, row_set.at[on]), speed)
        change: Array = response.X[:, on].dot(p)
        return change

    def _bounds(self, problem: StepProblem, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the smallest and largest impulses of rows in a step."""
        return problem.h * self._rows.lower[at], problem.h * self._rows.upper[at]


class StepRows:
    """All unilateral and bounded rows, in every step.

    Attributes:
        every: All of them.
        are_one_sided: Whether any row only pushes.
    """

    def __init__(self, mechanism: Mechanism, rows: ConstraintRows) -> None:
        self._k = mechanism.k
        self.rows = rows
        self.all_rows = all_rows(rows)
        self.are_one_sided = bool(self.all_rows.pushes.any())
        self._of_g, self._of_J = (
            min(rows.reads, reads) for reads in (Reads.POSITION, Reads.JACOBIAN)
        )

    def turn_rate(self, v: Array) -> float:
        """Return the angular speed of bodies beside contacts for a velocity of all joints."""
        return 0.0

    def start_from(self, q: Array) -> None:
        """Take note of the configuration from which a step starts."""

    def record_displacement(self, q: Array, displacement: Array) -> None:
        """Take note of a displacement of all joints, shape (nv,), and where it leads."""

    def at(self, x: State, free: Array, h: float) -> RowsAt:
        """Return the rows at a state of all joints, with bounds that are those of it.

        Args:
            x: The state, within a step.
            free: Velocity at its end without the rows, shape (nv,).
            h: Its length [s].
        """
        k, rows = self._k, self.rows
        k.refresh(x.q, x.v, rows.reads)
        if rows.varies:
            rows.limit(k, x)
        J, drift = (each.copy() for each in rows.accelerations(k, x))
        return RowsAt(self.all_rows, J, drift, rows.residual(k, x), rows.rate(k, x))

    def gaps(self, x: State) -> Array | None:
        """Return g of one-sided rows at a state of all joints, shape (m,); inf for other rows.

        Returns:
            None where no row may be beyond 0.
        """
        self._k.refresh(x.q, x.v, self._of_g)
        return np.where(self.all_rows.pushes, self.rows.residual(self._k, x), np.inf)

    def response(self, without_rows: ImpulseResponse, K: Array, J: Array) -> ImpulseResponse:
        """Return how impulses of the rows move the joints.

        Args:
            held: What moves them, for other rows.
            K: Its mass matrix, shape (nv, nv).
            J: The rows, shape (m, nv).
        """
        return without_rows.of(J)

    def jacobian(self, x: State, on: NDArray[np.intp]) -> Array:
        """Return some rows of dg/dq at a state of all joints."""
        self._k.refresh(x.q, x.v, self._of_J)
        return self.rows.jacobian(self._k, x)[on]


class RowsAt(NamedTuple):
    """Rows at one state.

    Attributes:
        row_set: The set of the rows.
        J: Their Jacobian, shape (m, nv).
        drift: Their J' v, shape (m,).
        gap: Their g, shape (m,).
        own: Their g' without J v, shape (m,).
    """

    row_set: RowSet
    J: Array
    drift: Array
    gap: Array
    own: Array


class RowSet(NamedTuple):
    """A set of rows that may be active in a step.

    Attributes:
        at: Numbers among all unilateral and bounded rows, shape (m,).
        names: One a row.
        pushes: Which are unilateral, normals of contacts among them, shape (m,).
        decides: The row that decides whether a row is active: the normal of a contact, else the
            row itself.
        cones: The contacts, their slots counted here.
        tangents: Their rows along tangents, shape (2 n,).
    """

    at: NDArray[np.intp]
    names: list[str]
    pushes: Which
    decides: NDArray[np.intp]
    cones: tuple[Cone, ...]
    tangents: NDArray[np.intp]

    def chosen(self, on: NDArray[np.intp]) -> RowSet:
        """Return some of them; of a contact all rows or none.

        Args:
            on: Their places here, in the order that is wanted.
        """
        own = np.full(len(self.at), -1, dtype=np.intp)
        own[on] = np.arange(len(on))
        starts = [(cone, int(own[cone.slots.start])) for cone in self.cones]
        cones = (c._replace(slots=slice(start, start + 3)) for c, start in starts if start >= 0)
        names = [self.names[i] for i in on.tolist()]
        return _row_set(self.at[on], names, self.pushes[on], tuple(cones))


def _row_set(
    at: NDArray[np.intp], names: list[str], pushes: Which, cones: tuple[Cone, ...]
) -> RowSet:
    decides = np.arange(len(at))
    for cone in cones:
        decides[cone.slots] = cone.slots.start
    tangents = np.flatnonzero(decides != np.arange(len(at)))
    return RowSet(at, names, pushes, decides, cones, tangents)


def all_rows(rows: ConstraintRows) -> RowSet:
    """Return all rows that give way."""
    pushes = np.zeros(len(rows.rows), dtype=np.bool_)
    for block, mine in zip(rows.blocks, rows.slices, strict=True):
        pushes[mine] = block.law.kind is Kind.UNILATERAL
    for cone in rows.cones:
        pushes[cone.slots.start] = True
    return _row_set(np.arange(len(pushes)), [row.name for row in rows.rows], pushes, rows.cones)
