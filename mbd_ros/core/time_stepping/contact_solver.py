"""Rows that give way in a step of velocities, contacts with friction among them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.contact_problem import ContactProblem, Residuals
from mbd_ros.core.dynamics.impulse_response import ImpulseResponse
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array
from mbd_ros.core.time_stepping.bounded_rows import GivingWay
from mbd_ros.core.time_stepping.consistent_rates import AnsweredRates, is_independent
from mbd_ros.core.time_stepping.contact_subproblem import OF_ONE, AskedContacts
from mbd_ros.core.time_stepping.slip_ends import dots, ending, given_back, turned
from mbd_ros.core.time_stepping.step_problem import StepProblem
from mbd_ros.core.time_stepping.unilateral_rows import Acting, Slots, Which
from mbd_ros.errors import SolveError

_SLIPS = 1.0e-12  # of the square of a slip: it neither ends in the step nor turns round
_NO_ROOM = 1.0e-5  # of the rate of a gap: feet of a body, which rounding sets apart, share a load
_SETS = 256  # of rows that are remembered


class ContactsInStep(GivingWay):
    """One complementarity problem a step for all rows that give way, contacts among them.

    Friction is against the slip at the end of the step where that begins, ends or turns round in
    it, else against the mean slip of the step, which is of second order where slip turns.

    Args:
        rows: The rows; their bounds are those of the state that was last asked for.
        theta: Share of the velocity at the end of a step in the mean one.

    Attributes:
        last: Impulses of the last problem, with which the next one begins, shape (m,).
        forces: Mean forces of the rows in the last step, shape (m,); None before the first one.
    """

    def __init__(self, rows: ConstraintRows, theta: float) -> None:
        super().__init__(rows)
        self._late = (1.0 - theta) / theta
        self.last = np.zeros(len(rows.rows))
        self.forget()
        self._accepted: tuple[Array, Array | None, tuple[Any, ...]] = self.last, None, ()
        self._sets: dict[bytes, Acting] = {}
        self._answers = AnsweredRates()
        self._solver: tuple[ImpulseResponse, Acting, Array, ContactProblem] | None = None

    def end(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Velocity at the end of the step; arguments as without contacts.

        Rows that others push beyond 0 push, too.
        """
        self.forces = np.zeros(len(self.last))
        if not len(closed):
            return free + 0.0
        while True:
            end = self.pushed(problem, closed, free, near)
            more = problem.passed(end) & ~closed
            if not more.any():
                return end
            closed = closed | more

    def pushed(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Velocity at the end of the step if no other rows push; arguments as for `end`."""
        if not closed.any():
            return super().pushed(problem, closed, free)
        acting = problem.acting
        on = np.flatnonzero((closed | ~acting.pushes)[acting.decides])
        chosen = self._chosen(acting, on)
        if not chosen.cones:
            return super().pushed(problem, closed, free)
        return free + self._with_contacts(problem, chosen, on, free, near)

    def turned(self, problem: StepProblem, end: Array) -> Slots | None:
        """Tangents of contacts whose friction would do work: slips that end within the step."""
        self._accepted = self.last.copy(), self.forces, self.shared
        return turned(problem, end, self.last)

    def ending(self, turned: Slots, problem: StepProblem, end: Array) -> float:
        """When the first of some slips ends [s]; arguments as those of `slip_ends.ending`."""
        return ending(turned, problem, end)

    def accept(self) -> None:
        """Go on from the step that `turned` looked at: those after it were tried only."""
        self.last[:], self.forces, self.shared = self._accepted

    def given_back(self, problem: StepProblem, end: Array) -> Array | None:
        """What is taken from the way of the step, so that friction does no work along it."""
        return given_back(problem, end, self.last)

    def forget(self) -> None:
        """Begin to look for the largest residuals anew."""
        self.worst = Residuals(0.0, 0.0, 0.0, 0.0)

    def _with_contacts(
        self,
        problem: StepProblem,
        chosen: Acting,
        on: NDArray[np.intp],
        free: Array,
        near: Array | None,
    ) -> Array:
        """What the impulses of some rows, contacts among them, add to a velocity."""
        response = problem.response
        A, solver = self._of(response, chosen, on)
        known = *self._bounds(problem, chosen.at), problem.speed(free)
        kept = self._kept_bend(problem, on, A)
        b = problem.J[on].dot(free) + problem.offset[on] + (kept - problem.bend[on])
        room = problem.rates_left(on)
        b += np.where(room <= _NO_ROOM * np.abs(b), 0.0, room)
        warm = self.last[chosen.at]
        asked = AskedContacts(
            problem, chosen, on, A, solver, b, kept, known, warm, near is not None
        )
        p = None if near is None else self._sliding(asked, near)
        if p is None:
            p = self._held(asked)
        else:
            self.shared = ()
        if near is not None:
            left = asked.left(p) if p is asked.warm else solver.residuals
            self.worst = Residuals(*map(max, self.worst, left))
        self.last[:] = 0.0
        self.last[chosen.at] = p
        self.forces = np.zeros(len(self.last))
        self.forces[chosen.at] = p / problem.h
        change: Array = response.X[:, on].dot(p)
        return change

    def _held(self, asked: AskedContacts) -> Array:
        """Impulses of a problem: the last ones, where contacts are held by them still."""
        at, A, last = asked.chosen.at, asked.A, self.shared
        same = bool(last) and np.array_equal(last[1], A) and np.array_equal(last[0], at)
        if same and asked.sticks():
            return asked.warm
        self.shared = (at, A) if asked.shared and len(A) > OF_ONE else ()
        return asked.solve()

    def _of(
        self, response: ImpulseResponse, chosen: Acting, on: NDArray[np.intp]
    ) -> tuple[Array, ContactProblem]:
        """A of some rows and its solver, the ones before while nothing but forces changes."""
        if self._solver is None or not (response is self._solver[0] and chosen is self._solver[1]):
            A = response.A if len(on) == len(response.A) else response.A[np.ix_(on, on)]
            solver = ContactProblem(A, response.loose[on], chosen.names, chosen.cones)
            self._solver = response, chosen, A, solver
        return self._solver[2:]

    def _sliding(self, asked: AskedContacts, near: Array) -> Array | None:
        """Impulses where some contacts slide all along; None where none does."""
        problem, chosen, on, b = asked.problem, asked.chosen, asked.on, asked.b
        at, tangents = on[chosen.tangents], chosen.tangents
        J, own = problem.J[at], problem.offset[at] - problem.bend[at]
        before, slip = ((J.dot(v) + own).reshape(-1, 2) for v in (problem.x.v, near))
        none = np.square(problem.slight(problem.free)[at[::2]])
        least = _SLIPS * dots(before, before)
        slides = dots(slip, before) > np.maximum(least, none)
        while slides.any():
            late = np.zeros(len(b))
            shift = self._late * before - asked.bend[tangents].reshape(-1, 2)
            late[tangents] = (slides[:, None] * shift).ravel()
            late = self._answers.possible(late, asked.A, tangents[np.repeat(slides, 2)])
            try:
                p = asked.solve(late)
            except SolveError:  # where one stops, slips of others may contradict one another
                return None
            end = asked.A[tangents].dot(p) + b[tangents] + late[tangents]
            mean = end.reshape(-1, 2)
            goes_on = np.minimum(dots(slip, mean), dots(before, mean)) > least
            if (goes_on | ~slides).all():
                return p if asked.takes_energy(p, before) else None
            slides &= goes_on
        return None

    def _kept_bend(self, problem: StepProblem, on: NDArray[np.intp], A: Array) -> Array:
        """What rates have from the change of J, without what no motion of the bodies answers.

        Rows that depend on one another would stick with rates that contradict one another: feet
        of a body that turns and comes to rest move apart by (w h)^2 / 2 of their distance.
        """
        bend = problem.bend[on]
        if is_independent(A) or (np.abs(bend) <= problem.slight(problem.free)[on]).all():
            return bend
        none = self._answers.none(A)
        moved: Array = bend - none.dot(none.T.dot(bend))
        return moved

    def _chosen(self, acting: Acting, on: NDArray[np.intp]) -> Acting:
        """The rows that are on; of a contact all or none."""
        if len(on) == len(acting.at):
            return acting
        key = acting.at[on].tobytes()
        if key not in self._sets:
            if len(self._sets) >= _SETS:
                self._sets.clear()
            self._sets[key] = acting.chosen(on)
        return self._sets[key]
