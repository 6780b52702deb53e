"""Contacts with friction in a step of Moreau and Jean, with the other rows in one problem.

    w = A p + b,   A = J K^-1 J',   b = J free + offset

is solved with the laws of Signorini and Coulomb (`complementarity/contact_problem`). Friction is
against the slip at the end of the step where that begins, ends or turns round in it, else against
the mean slip of the step, which is of second order where slip turns.
"""

from __future__ import annotations

import math
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.contact_problem import ContactProblem, Residuals
from mbd_ros.core.dynamics.mechanism import ImpulseResponse, Mechanism
from mbd_ros.core.nonsmooth.unilateral_rows import (
    RowsAt,
    RowSet,
    Slots,
    StepProblem,
    StepRows,
    UnilateralSolver,
    Which,
)
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.gap_speed_bound import GapSpeed, bodies_of
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import SolveError

_WORK = 1.0e-11  # of the kinetic energy: work of friction that is none
_SLIGHT = 1.0e-4  # of what friction adds to a slip in a step: one that has ended before
_DEPENDENT = 1.0e-12  # of the largest singular value: rows that depend on others
_SEEN = 0.1  # of a slip, which must be left for its end to be foretold
_ROWS_OF_ONE = 3  # rows of one contact
_ACCEPTED = 1.0e-9  # of the rates that impulses of a step end: what may be left of them
_SAME = 1.0e-14  # of rates: what rounding leaves of them
_FLAT = 1.0e-10  # of the product of its mobilities: rows that may depend on one another
_DEPENDS = 1.0e-6  # of rates that no impulses make: what sliding tangents have of them
_SLIPS = 1.0e-12  # of the square of a slip: it neither ends in the step nor turns round
_NO_ROOM = 1.0e-5  # of the rate of a gap: feet of a body, which rounding sets apart, share a load
_SETS = 256  # of rows that are remembered
_WAYS = 4.0  # of a step: gaps that may close in it, whatever other rows push
_CURVED = 2.0  # longest displacement of dependent joints, of the one that their velocity predicts
_SCREENED_ROWS_OF_ONE = 3  # rows of one contact
_SCREENED_SETS = 256  # of rows that are remembered


class ContactSolver(UnilateralSolver):
    """Solves one complementarity problem a step for all rows, contacts among them.

    Friction acts against the slip at the end of the step where a slip begins, ends or reverses in
    it, and else against the mean slip of the step, which is of second order where a slip turns.

    Args:
        rows: The rows, with the bounds of their last state.
        theta: Share of the velocity at the end of a step in the mean one.

    Attributes:
        last: Impulses of the last problem, with which the next one begins, shape (m,).
        forces: Mean forces of the rows in the last step, shape (m,); None before the first one.
    """

    def __init__(self, rows: ConstraintRows, theta: float) -> None:
        super().__init__(rows)
        self._late = (1.0 - theta) / theta
        self.last = np.zeros(len(rows.rows))
        self.reset_residuals()
        self._accepted: tuple[Array, Array | None, tuple[Any, ...]] = self.last, None, ()
        self._sets: dict[bytes, RowSet] = {}
        self._answers = ConsistentRates()
        self._solver: tuple[ImpulseResponse, RowSet, Array, ContactProblem] | None = None

    def solve(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Return the velocity at the end of the step.

        Rows that others push beyond 0 push, too.
        """
        self.forces = np.zeros(len(self.last))
        if not len(closed):
            return free + 0.0
        while True:
            end = self.solve_active(problem, closed, free, near)
            more = problem.passed(end) & ~closed
            if not more.any():
                return end
            closed = closed | more

    def solve_active(
        self, problem: StepProblem, closed: Which, free: Array, near: Array | None = None
    ) -> Array:
        """Velocity at the end of the step if no other rows push; arguments as for `end`."""
        if not closed.any():
            return super().solve_active(problem, closed, free)
        row_set = problem.row_set
        on = np.flatnonzero((closed | ~row_set.pushes)[row_set.decides])
        chosen = self._chosen(row_set, on)
        if not chosen.cones:
            return super().solve_active(problem, closed, free)
        return free + self._with_contacts(problem, chosen, on, free, near)

    def early_slips(self, problem: StepProblem, end: Array) -> Slots | None:
        """Return the tangents of contacts whose slip ends within the step.

        Friction holds a contact at the end of a step. Where its slip ends early in the step, that
        friction would push along the rest of the displacement, and do work: such a step is divided
        where the slip ends.

        Args:
            problem: Problem of the step.
            end: Velocity at its end, shape (nv,).

        Returns:
            Numbers among all rows; None without any.
        """
        self._accepted = self.last.copy(), self.forces, self.shared
        tangents = problem.row_set.tangents
        if not len(tangents):
            return None
        before, after = _slips(problem, end, tangents)
        push = self.last[problem.row_set.at[tangents]].reshape(-1, 2)
        gains = _dots(before + after, push) > _WORK * problem.speed(problem.free) ** 2
        if not gains.any():
            return None
        added = problem.response.loose[tangents].reshape(-1, 2).max(axis=1) * np.sqrt(
            _dots(push, push)
        )
        gains &= _dots(before, before) > np.square(_SLIGHT * added)
        chosen: Slots = problem.row_set.at[tangents].reshape(-1, 2)[gains].ravel()
        return chosen if len(chosen) else None

    def first_slip_end(self, slips: Slots, problem: StepProblem, end: Array) -> float:
        """Return when the first of some slips ends if it goes on as in a short step [s].

        Args:
            slips: Tangents of contacts, among the rows of all.
            problem: That of the short step.
            end: Velocity at its end, shape (nv,).

        Returns:
            The time since the start of the short step; 0 if one has ended.
        """
        tangents = np.flatnonzero(np.isin(problem.row_set.at, slips))
        if not len(tangents):
            return 0.0
        before, after = _slips(problem, end, tangents)
        size, left = _dots(before, before), _dots(before, after)
        if not (left > _SEEN * size).all():
            return 0.0
        with np.errstate(divide="ignore"):  # a slip that does not end
            parts = size / np.maximum(size - left, 0.0)
        return problem.h * float(parts.min())

    def accept(self) -> None:
        """Accept the step that `early_slips` has searched; later ones were trials."""
        self.last[:], self.forces, self.shared = self._accepted

    def displacement_correction(self, problem: StepProblem, end: Array) -> Array | None:
        """Return the correction of the displacement of a step; None where friction does no work.

        Where slips are too slow for the step to be divided, contacts move with the slips at the
        end of the step, so that friction only ever takes energy: with it they have gone
        h s+ along their tangents instead of h ((1 - theta) s + theta s+), s the slips at the start
        and s+ those at the end, moved the least in the mass metric. Friction p, which is against
        s+, then takes the energy -p . s+ + (s+ - s) . A^-1 (s+ - s) / 2 >= 0.

        Args:
            problem: That of the step.
            end: Velocity at its end, shape (nv,).
        """
        row_set, tangents = problem.row_set, problem.row_set.tangents
        if not len(tangents):
            return None
        before, after = _slips(problem, end, tangents)
        push = self.last[row_set.at[tangents]].reshape(-1, 2)
        least = _WORK * problem.speed(problem.free) ** 2
        if float(_dots(before + after, push).sum()) <= least:
            return None
        touching = self.last[row_set.at[tangents[::2] - 1]] > 0.0
        rows = np.column_stack((tangents[::2] - 1, tangents[::2], tangents[1::2]))[
            touching
        ].ravel()
        late = np.column_stack((np.zeros(len(before)), before - after))[touching].ravel()
        X, A = problem.response.X[:, rows], problem.response.A[np.ix_(rows, rows)]
        scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), np.finfo(float).tiny))
        moved = np.linalg.lstsq(scale[:, None] * A * scale, scale * late, rcond=_DEPENDENT)[0]
        displacement: Array = (1.0 - problem.theta) * problem.h * X.dot(scale * moved)
        return displacement

    def reset_residuals(self) -> None:
        """Set the largest residuals to 0."""
        self.worst = Residuals(0.0, 0.0, 0.0, 0.0)

    def _with_contacts(
        self,
        problem: StepProblem,
        chosen: RowSet,
        on: NDArray[np.intp],
        free: Array,
        near: Array | None,
    ) -> Array:
        """Return what the impulses of some rows, contacts among them, add to a velocity."""
        response = problem.response
        A, solver = self._of(response, chosen, on)
        known = *self._bounds(problem, chosen.at), problem.speed(free)
        known_bend = self._kept_bend(problem, on, A)
        b = problem.J[on].dot(free) + problem.offset[on] + (known_bend - problem.bend[on])
        room = problem.rates_left(on)
        b += np.where(room <= _NO_ROOM * np.abs(b), 0.0, room)
        warm = self.last[chosen.at]
        subproblem = ContactSubproblem(
            problem, chosen, on, A, solver, b, known_bend, known, warm, near is not None
        )
        p = None if near is None else self._sliding(subproblem, near)
        if p is None:
            p = self._solve_or_hold(subproblem)
        else:
            self.shared = ()
        if near is not None:
            left = subproblem.left(p) if p is subproblem.warm else solver.residuals
            self.worst = Residuals(*map(max, self.worst, left))
        self.last[:] = 0.0
        self.last[chosen.at] = p
        self.forces = np.zeros(len(self.last))
        self.forces[chosen.at] = p / problem.h
        change: Array = response.X[:, on].dot(p)
        return change

    def _solve_or_hold(self, subproblem: ContactSubproblem) -> Array:
        """Return impulses of a problem: the last ones, where contacts are held by them still."""
        at, A, last = subproblem.chosen.at, subproblem.A, self.shared
        same = bool(last) and np.array_equal(last[1], A) and np.array_equal(last[0], at)
        if same and subproblem.sticks():
            return subproblem.warm
        self.shared = (at, A) if subproblem.shared and len(A) > _ROWS_OF_ONE else ()
        return subproblem.solve()

    def _of(
        self, response: ImpulseResponse, chosen: RowSet, on: NDArray[np.intp]
    ) -> tuple[Array, ContactProblem]:
        """A of some rows and its solver, the ones before while nothing but forces changes."""
        if self._solver is None or not (response is self._solver[0] and chosen is self._solver[1]):
            A = response.A if len(on) == len(response.A) else response.A[np.ix_(on, on)]
            solver = ContactProblem(A, response.loose[on], chosen.names, chosen.cones)
            self._solver = response, chosen, A, solver
        return self._solver[2:]

    def _sliding(self, subproblem: ContactSubproblem, near: Array) -> Array | None:
        """Return impulses where some contacts slide all along; None where none does."""
        problem, chosen, on, b = subproblem.problem, subproblem.chosen, subproblem.on, subproblem.b
        at, tangents = on[chosen.tangents], chosen.tangents
        J, own = problem.J[at], problem.offset[at] - problem.bend[at]
        before, slip = ((J.dot(v) + own).reshape(-1, 2) for v in (problem.x.v, near))
        none = np.square(problem.slight(problem.free)[at[::2]])
        least = _SLIPS * _dots(before, before)
        slides = _dots(slip, before) > np.maximum(least, none)
        while slides.any():
            late = np.zeros(len(b))
            shift = self._late * before - subproblem.bend[tangents].reshape(-1, 2)
            late[tangents] = (slides[:, None] * shift).ravel()
            late = self._answers.possible(late, subproblem.A, tangents[np.repeat(slides, 2)])
            try:
                p = subproblem.solve(late)
            except SolveError:  # where one stops, slips of others may contradict one another
                return None
            end = subproblem.A[tangents].dot(p) + b[tangents] + late[tangents]
            mean = end.reshape(-1, 2)
            goes_on = np.minimum(_dots(slip, mean), _dots(before, mean)) > least
            if (goes_on | ~slides).all():
                return p if subproblem.takes_energy(p, before) else None
            slides &= goes_on
        return None

    def _kept_bend(self, problem: StepProblem, on: NDArray[np.intp], A: Array) -> Array:
        """Return the rates from the change of J, without the part that no motion of bodies makes.

        Rows that depend on one another would stick with rates that contradict one another: feet
        of a body that turns and comes to rest move apart by (w h)^2 / 2 of their distance.
        """
        bend = problem.bend[on]
        if is_independent(A) or (np.abs(bend) <= problem.slight(problem.free)[on]).all():
            return bend
        none = self._answers.none(A)
        moved: Array = bend - none.dot(none.T.dot(bend))
        return moved

    def _chosen(self, row_set: RowSet, on: NDArray[np.intp]) -> RowSet:
        """Return the rows that are on; of a contact all or none."""
        if len(on) == len(row_set.at):
            return row_set
        key = row_set.at[on].tobytes()
        if key not in self._sets:
            if len(self._sets) >= _SETS:
                self._sets.clear()
            self._sets[key] = row_set.chosen(on)
        return self._sets[key]


def _slips(problem: StepProblem, end: Array, tangents: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return slips at the start and at the end of a step [m/s], shape (n, 2) each."""
    after = problem.J[tangents].dot(end) + problem.offset[tangents]
    return problem.rate[tangents].reshape(-1, 2), after.reshape(-1, 2)


def _dots(a: Array, b: Array) -> Array:
    """Return products of vectors, shape (n,)."""
    return np.einsum("ij,ij->i", a, b)


def is_independent(A: Array) -> bool:
    """Whether the rows of one contact certainly do not depend on one another; no for more."""
    if len(A) != _ROWS_OF_ONE:
        return False
    (n, x, y), (_, p, q), (_, _, r) = A.tolist()
    volume = n * (p * r - q * q) - x * (x * r - q * y) + y * (x * q - p * y)
    return bool(volume > _FLAT * n * p * r)


class ContactSubproblem(NamedTuple):
    """One problem with contacts.

    Attributes:
        problem: That of the step.
        chosen: The rows that are on.
        on: Their places in the problem of the step.
        A: Rates that their impulses add, shape (m, m).
        solver: Of their laws.
        b: Their rates without impulses, shape (m,).
        bend: What of these comes from the change of J, shape (m,).
        known: Bounds of the impulses, and a velocity.
        warm: Impulses to begin with, shape (m,).
        shared: Whether contacts that depend on one another share with the least norm: those of
            the end of a step do, the next one begins with them.
    """

    problem: StepProblem
    chosen: RowSet
    on: NDArray[np.intp]
    A: Array
    solver: ContactProblem
    b: Array
    bend: Array
    known: tuple[Array, Array, float]
    warm: Array
    shared: bool

    def solve(self, late: Array | None = None) -> Array:
        """Return the impulses, shape (m,); arguments as for `ContactProblem`."""
        known = *self.known, late, self.warm
        return self.solver.solve(self.b, *known, shared=self.shared, accepted=_ACCEPTED)

    def sticks(self) -> bool:
        """Whether those to begin with, if within the cones, leave all contacts at rest."""
        if len(self.b) != _ROWS_OF_ONE * len(self.chosen.cones):
            return False
        size = float(np.abs(self.b).max())
        return float(np.abs(self.A.dot(self.warm) + self.b).max()) <= _SAME * size

    def takes_energy(self, p: Array, before: Array) -> bool:
        """Whether friction does no work in all, with slips before the step, shape (n, 2)."""
        at = self.chosen.tangents
        end = (self.A[at].dot(p) + self.b[at] - self.bend[at]).reshape(-1, 2)
        work = float(_dots(before + end, p[at].reshape(-1, 2)).sum())
        return work <= _WORK * self.known[2] ** 2

    def left(self, p: Array) -> Residuals:
        """Return what impulses leave of the laws where all contacts are at rest."""
        w, parts = self.A.dot(p) + self.b, p.reshape(-1, 3)
        slips = w.reshape(-1, 3)[:, 1:]
        mu = np.array([cone.mu for cone in self.chosen.cones])
        over = float((np.hypot(parts[:, 1], parts[:, 2]) - mu * parts[:, 0]).max())
        slip = math.sqrt(float(_dots(slips, slips).max()))
        return Residuals(float(np.abs(w[::3]).max()), 0.0, max(over, 0.0), slip)


class ConsistentRates:
    """Rates that no impulses make, remembered while A is the same."""

    def __init__(self) -> None:
        self._last: tuple[Array, Array] | None = None

    def none(self, A: Array) -> Array:
        """Return rates that no impulses make, orthonormal in columns, shape (m, dependent)."""
        if self._last is None or self._last[0] is not A:
            values, ways = np.linalg.eigh(0.5 * (A + A.T))
            self._last = A, ways[:, values <= redundant(len(A)) * values[-1]]
        return self._last[1]

    def possible(self, late: Array, A: Array, slide: Slots) -> Array:
        """Return earlier rates of tangents that slide, as far as they contradict no other rows.

        Args:
            late: Rates, 0 but at these tangents, shape (m,).
            A: Rates that impulses add, shape (m, m).
            slide: The tangents that slide.
        """
        if is_independent(A) or not (none := self.none(A)).size:
            return late
        over, sizes, _ = np.linalg.svd(none[slide], full_matrices=False)
        over = over[:, sizes > _DEPENDS]
        late[slide] -= over.dot(over.T.dot(late[slide]))
        return late


class ContactScreening(StepRows):
    """Unilateral and bounded rows, with contacts only where a step may close their gaps.

    A contact that its bodies cannot close within a few steps is not evaluated: its last gap is
    reduced by the largest speed of the gap per speed of the joints, times the displacement of the
    joints since (`core/rows/gap_speed_bound`). That saves time and changes no result.

    Args:
        is_whole: Whether all joints are integrated; others may curve on their way.
    """

    def __init__(self, mechanism: Mechanism, rows: ConstraintRows, is_whole: bool) -> None:
        super().__init__(mechanism, rows)
        self._sets: dict[bytes, RowSet] = {}
        self._longer = 1.0 if is_whole else _CURVED
        self._data = mechanism.data
        self._m = len(rows.rows)
        blocks = list(zip(rows.blocks, rows.slices, strict=True))
        contacts = [(block.part, at) for block, at in blocks if block.law.kind is Kind.CONE]
        others = [(block, at) for block, at in blocks if block.law.kind is not Kind.CONE]
        self._contacts = [(part, np.arange(at.start, at.stop)) for part, at in contacts]
        self._others = ConstraintRows([block for block, _ in others], int(mechanism.model.nv))
        is_other = np.zeros(self._m, dtype=np.bool_)
        for _, at in others:
            is_other[at] = True
        self._at_others = np.flatnonzero(is_other)
        self._others_push = bool(self.all_rows.pushes[is_other].any())
        self._speed = GapSpeed(mechanism.robot, [bodies_of(part) for part, _ in contacts])
        self._last_response: tuple[Array, Array, ImpulseResponse] | None = None
        self._room = np.zeros(len(contacts))
        self._spare = 0.0
        self._q = mechanism.zero
        self._displacement = mechanism.zero
        self._path = mechanism.zero.copy()
        row_set = self._row_set(self.all_rows.at[:0])
        self._nothing = RowsAt(row_set, np.zeros((0, len(self._displacement))), *np.zeros((3, 0)))

    def turn_rate(self, v: Array) -> float:
        """How fast bodies turn with a velocity of all joints, of all of them together [rad/s]."""
        return float(np.linalg.norm(self._speed.turns * v))

    def start_from(self, q: Array) -> None:
        """Take note of the configuration from which a step starts."""
        if q is not self._q:
            self._room[:] = self._speed.room[:] = self._spare = 0.0

    def record_displacement(self, q: Array, displacement: Array) -> None:
        """Take note of a displacement of all joints, shape (nv,), and where it leads."""
        self._q = q
        self._displacement = self._longer * displacement
        self._path += np.abs(self._displacement)
        self._spare -= math.sqrt(self._displacement.dot(self._displacement))

    def at(self, x: State, free: Array, h: float) -> RowsAt:
        """Return the rows at a state of all joints; arguments as for all rows."""
        k, rows, others = self._k, self.rows, self._others
        fastest = math.sqrt(max(x.v.dot(x.v), free.dot(free)))
        if self._spare > _WAYS * h * fastest:
            if not len(self._at_others):
                return self._nothing
            looked_at, ways = [], self._room
        else:
            ways = self._reach(_WAYS * h * np.maximum(np.abs(x.v), np.abs(free)))
            looked_at = np.flatnonzero(self._room <= ways).tolist()
        k.refresh(x.q, x.v, rows.reads if looked_at else others.reads)
        if rows.varies:
            rows.limit(k, x)
        at: list[NDArray[np.intp]] = []
        pieces: list[tuple[Array, ...]] = []
        if len(self._at_others):
            J, drift = others.accelerations(k, x)
            at.append(self._at_others)
            pieces.append((J, drift, others.residual(k, x), others.rate(k, x)))
        for i in looked_at:
            part, slots = self._contacts[i]
            gap = part.residual(k, x)
            near = np.repeat(gap[::3] < ways[i], 3)
            if near.any():
                each = *part.accelerations(k, x), gap, part.rate(k, x)
                is_whole = near.all()
                at.append(slots if is_whole else slots[near])
                pieces.append(each if is_whole else tuple(array[near] for array in each))
        if not pieces:
            return self._nothing
        if len(pieces) == 1 and at[0] is not self._at_others:
            J, *known = pieces[0]
            return RowsAt(self._row_set(at[0]), _rounded(J), *known)
        J, *stacked = (np.concatenate(each) for each in zip(*pieces, strict=True))
        return RowsAt(self._row_set(np.concatenate(at)), _rounded(J), *stacked)

    def response(self, without_rows: ImpulseResponse, K: Array, J: Array) -> ImpulseResponse:
        """Return the response of the joints; that of the last step where K and J are the same."""
        if len(J) <= _SCREENED_ROWS_OF_ONE or not without_rows.is_free:
            return without_rows.of(J)
        last = self._last_response
        if last is None or not (np.array_equal(K, last[0]) and np.array_equal(J, last[1])):
            self._last_response = last = K, J, without_rows.of(J)
        return copy(last[2])

    def gaps(self, x: State) -> Array | None:
        """Return g of one-sided rows at a state of all joints, shape (m,); inf for other rows.

        Contacts that have room are passed over, and count as infinitely far; None where all rows
        are.
        """
        looked_at = list[int]()
        if self._spare <= _WAYS * math.sqrt(self._displacement.dot(self._displacement)):
            ways = self._reach(_WAYS * np.abs(self._displacement))
            looked_at = np.flatnonzero(self._room <= ways).tolist()
        if not looked_at and not self._others_push:
            return None
        self._k.refresh(x.q, x.v, self._of_g)
        if not self._speed.is_measured:
            self._speed.measure(self._data)
        gaps = np.full(self._m, np.inf)
        if self._others_push:
            gaps[self._at_others] = self._others.residual(self._k, x)
        for i in looked_at:
            part, at = self._contacts[i]
            gaps[at] = part.residual(self._k, x)
            pair = part.pair
            own = gaps[at[::3]]
            self._room[i] = own.min() if pair is None else pair.clearance(self._k, own)
        if looked_at:
            self._spare = self._speed.shortest(self._room)
        return np.where(self.all_rows.pushes, gaps, np.inf)

    def _reach(self, displacement: Array) -> Array:
        """Return how far gaps change at most on a displacement of the joints [m], one a contact.

        Brings `room` up to date.
        """
        speed, gone = self._speed, self._speed.weights.dot(self._path)
        self._room -= gone
        speed.room -= gone
        self._path[:] = 0.0
        self._spare = speed.shortest(self._room)
        return np.where(speed.room > 0.0, speed.weights.dot(displacement), np.inf)

    def _row_set(self, at: NDArray[np.intp]) -> RowSet:
        """Return the rows that stand there; of a contact all or none."""
        key = at.tobytes()
        if key not in self._sets:
            if len(self._sets) >= _SCREENED_SETS:
                self._sets.clear()
            self._sets[key] = self.all_rows.chosen(at)
        return self._sets[key]


def _rounded(J: Array) -> Array:
    """Return rows to the last digit of the largest entry of each column.

    What rounding leaves of entries that are 0 differs from step to step, also of bodies at rest.
    """
    if len(J) <= _SCREENED_ROWS_OF_ONE:
        return J
    large = np.ldexp(1.0, np.frexp(np.abs(J).max(axis=0))[1])
    rounded: Array = (J + large) - large
    return rounded
