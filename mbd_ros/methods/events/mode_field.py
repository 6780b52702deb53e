"""A system in its modes: event-driven rows, then surfaces of switching forces."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contact_modes.event_rows import EventRows
from mbd_ros.core.contact_modes.row_distances import Distances, Reach, rounding
from mbd_ros.core.dynamics.system import Accelerator, System
from mbd_ros.core.optimization.box_qp import exchanged
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import TIE
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.events.crossings import PartGuards
from mbd_ros.methods.events.switching_surfaces import (
    MOST_SURFACES,
    SlidingField,
    equivalent_signs,
    mode_on,
)
from mbd_ros.methods.projection.assembly import assemble

_PASSES = 12
# A switch, and 0 where it is reached; 1 or -1 where it is left on that side.
Margin = tuple[int, int]
_SAME = 1.0e-6  # signs that give the same motion


class ModeField:
    """The switches of a system, one entry of a mode each, and its motion in a mode.

    A switch is off beside its surface or gap, on the side 1 or -1 that its mode says, and active
    at mode 0. It leaves on the side 1 or -1 once its multiplier passes a bound. The field has no
    state: modes, and the sides on which guards act, are arguments.

    Args:
        system: The system.
        with_surfaces: Whether surfaces of switching forces are switches, too; their forces go by
            the signs of the heights otherwise.

    Attributes:
        system: The system in its modes.
        switches: Names of the switches: rows as their multipliers, then surfaces.
        names: The same, then the names of the guards of parts.
        guards: The guards of parts; their numbers follow those of the switches.
        rows: The event-driven rows; None without any.
        has_contacts: Whether contacts with friction are among them.
        surfaces: The system on its switching surfaces; None without any.
        count: Number of the event-driven rows.
        gaps: Numbers of the rows that are gaps.

    Raises:
        ModelError: Surfaces beside rows that are solved for in every evaluation.
    """

    def __init__(self, system: System, with_surfaces: bool) -> None:
        self.surfaces = SlidingField(system) if with_surfaces else None
        if self.surfaces is not None and system.bounded is not None:
            rows = ", ".join(row.name for row in system.bounded.rows)
            raise ModelError(
                f"filippov: switching forces beside bounded rows ({rows}) are solved for where "
                "these are exact; leave out smoothed and time_constant, or use another integrator"
            )
        self.system = system if self.surfaces is None else self.surfaces.system
        self.rows = self.system.event_rows
        self.has_contacts = self.rows is not None and self.rows.contacts is not None
        names = () if self.rows is None else self.rows.names
        self.count = len(names)
        self.switches = names if self.surfaces is None else (*names, *self.surfaces.names)
        reach = () if self.rows is None else self.rows.reach
        self._demands = [i for i, kind in enumerate(reach) if kind is Reach.DEMAND]
        self._frictions = [i for i, kind in enumerate(reach) if kind is Reach.FRICTION]
        self._without_distance = {*self._demands, *self._frictions}
        self._slips = [i for i, kind in enumerate(reach) if kind is Reach.SLIP]
        self.gaps = [i for i, kind in enumerate(reach) if kind is Reach.GAP]
        self.guards = PartGuards(self.system)
        self._first_guard = len(self.switches)
        self.names = (*self.switches, *self.guards.names)

    def drives(self, mode: Mode) -> list[int]:
        """Return the drives at their limit, whose margins are accelerations."""
        return [i for i in self._demands if mode[i]]

    def active(self, mode: Mode) -> list[int]:
        """Return the switches that are active."""
        return [i for i, side in enumerate(mode) if side == 0]

    def accelerator(self, mode: Mode) -> Accelerator:
        """Return the function that writes accelerations in a mode."""
        if self.surfaces is None:
            return self.system.accelerator(mode)
        return self.surfaces.accelerator(mode)

    def distances(self, y: State) -> Array:
        """Return gaps, slip velocities and heights; 1 for drives, which have no distance."""
        return self._stacked(
            None if self.rows is None else self.rows.measure(y).distances,
            None if self.surfaces is None else self.surfaces.heights(y),
        )

    def rates(
        self, y: State, u: Array | None, mode: Mode, measured: FieldDistances | None = None
    ) -> Array:
        """Return the rates of the distances in a mode; 0 for drives.

        Args:
            y: State of what is integrated.
            u: Inputs there.
            mode: The mode.
            measured: Distances of the state, where they are known.
        """
        rates = None
        if self.rows is not None:
            rates = self.rows.rates(y, None if measured is None else measured.rows).copy()
            if any(mode[i] for i in self._slips):
                rates[self._slips] = self.rows.row_accelerations(y, u, mode)[self._slips]
            rates[list(self._without_distance)] = 0.0
        surfaces = self.surfaces
        return self._stacked(rates, None if surfaces is None else surfaces.rates(y, u, mode))

    def near(self, y: State) -> set[int]:
        """Return switches that may be active to within rounding; always the drives."""
        return self._near(y, self.measure(y))

    def close(self, y: State, u: Array | None, mode: Mode) -> set[int]:
        """Return switches whose distance is 0 to within rounding, and guards that are zero."""
        return self._close(y, u, mode, self.measure(y))

    def begin(self, y: State, u: Array | None) -> tuple[Mode, set[int], set[int]]:
        """Return the mode that the distances of a state say, and `close` and `near` in it."""
        measured = self.measure(y)
        mode: Mode = ()
        if self.rows is not None:
            mode = self.rows.modes_by_distance(y, measured.rows)[0]
        if measured.heights is not None:
            mode = (*mode, *np.where(measured.heights < 0.0, -1, 1).tolist())
        return mode, self._close(y, u, mode, measured), self._near(y, measured)

    def measure(self, y: State) -> FieldDistances:
        """Measure the distances of all switches at a state."""
        return FieldDistances(
            None if self.rows is None else self.rows.measure(y),
            None if self.surfaces is None else self.surfaces.heights(y),
        )

    def _near(self, y: State, measured: FieldDistances) -> set[int]:
        near: set[int] = set()
        if self.rows is not None:
            near.update(self.rows.modes_by_distance(y, measured.rows)[1])
        if measured.heights is not None:
            at = np.flatnonzero(np.abs(measured.heights) <= rounding(y))
            near.update((at + self.count).tolist())
        return near

    def _close(self, y: State, u: Array | None, mode: Mode, measured: FieldDistances) -> set[int]:
        distances = None if measured.rows is None else measured.rows.distances
        stacked = self._stacked(distances, measured.heights)
        sizes = np.concatenate((stacked, self.guards.values(y, u, mode)))
        return set(np.flatnonzero(np.abs(sizes) <= rounding(y)).tolist())

    def guard_sides(
        self, y: State, u: Array | None, mode: Mode, left: Collection[int]
    ) -> tuple[int, ...]:
        """Return the sides on which guards of parts act in a step, 0 where one does not act.

        Args:
            y: State from which the step starts.
            u: Inputs there.
            mode: Mode of the step.
            left: Numbers of switches and guards that were zero just now.
        """
        if not self.guards.names:
            return ()
        values = self.guards.values(y, u, mode)
        numbers = {i - self._first_guard for i in left}
        return tuple(self.guards.sides(values, rounding(y), mode, numbers))

    def without_guard(self, sides: Sequence[int], guard: int) -> tuple[int, ...]:
        """Return the sides with which a guard does not act in a step; by its number."""
        return tuple(0 if self._first_guard + i == guard else s for i, s in enumerate(sides))

    def watched(self, sides: Sequence[int]) -> list[int]:
        """Return the numbers of the guards that act in a step."""
        return [self._first_guard + i for i, side in enumerate(sides) if side]

    def fired(
        self, y: State, u: Array | None, mode: Mode, sides: Sequence[int], guard: int
    ) -> list[int]:
        """Return the guards that act and are zero together with one of them."""
        watched = self.watched(sides)
        if guard < self._first_guard and not watched:
            return []
        is_zero = np.abs(self.guards.values(y, u, mode)) <= rounding(y)
        return [i for i in watched if i == guard or is_zero[i - self._first_guard]]

    def idle_guards(self, y: State, fired: Collection[int]) -> list[int]:
        """Return those of some guards that do not act at a state, by their condition."""
        return [i for i in fired if not self.guards.acts(y, i - self._first_guard)]

    def ending_guards(self, fired: Collection[int]) -> list[int]:
        """Return those of some guards that end a phase."""
        return [i for i in fired if self.guards.guards[i - self._first_guard].ends]

    def margin(
        self, y: State, u: Array | None, mode: Mode, which: Margin, sides: Sequence[int] = ()
    ) -> float:
        """Return one of the margins; a distance alone needs no acceleration."""
        switch, side = which
        if side or switch in self._without_distance or switch >= self._first_guard:
            return self.margins(y, u, mode, sides)[which]
        return float(mode[switch] * self.distances(y)[switch])

    def margins(
        self,
        y: State,
        u: Array | None,
        mode: Mode,
        sides: Sequence[int] = (),
        measured: FieldDistances | None = None,
    ) -> dict[Margin, float]:
        """Return what is positive while a mode goes on.

        Args:
            y: State of what is integrated.
            u: Inputs there.
            mode: The mode.
            sides: Sides on which guards of parts act, as `guard_sides`; empty where none act.
            measured: Distances of the state, where they are known.
        """
        measured = self.measure(y) if measured is None else measured
        row_distances = None if measured.rows is None else measured.rows.distances
        distances = self._stacked(row_distances, measured.heights).tolist()
        margins = {
            (i, 0): side * distances[i]
            for i, side in enumerate(mode)
            if side and i not in self._without_distance
        }
        n, rows = self.count, self.rows
        active = [i for i in range(n) if not mode[i]]
        if rows is not None and (active or self._demands):
            solution = rows.solve(y, u, mode)
            lam, lower, upper = solution.lam, solution.lower, solution.upper
            for i in (i for i in active if i not in self._frictions):
                if lower[i] > -np.inf:
                    margins[i, 1] = float(lam[i] - lower[i])
                if upper[i] < np.inf:
                    margins[i, -1] = float(upper[i] - lam[i])
            for i in self._demands:
                if mode[i]:
                    margins[i, 0] = float(mode[i] * solution.w[i])
            assert measured.rows is not None
            margins.update(rows.friction_margins(measured.rows, solution, mode))
        surfaces = self.surfaces
        if surfaces is not None and (sliding := surfaces.sliding(mode)):
            for i, s in zip(sliding, surfaces.signs(y, u, mode).tolist(), strict=True):
                margins[n + i, 1], margins[n + i, -1] = 1.0 - s, 1.0 + s
        if watched := self.watched(sides):
            values = self.guards.values(y, u, mode).tolist()
            for i in watched:
                margins[i, 0] = sides[i - self._first_guard] * values[i - self._first_guard]
        return margins

    def reset(self, y: State, u: Array | None, fired: Collection[int]) -> State:
        """Return the state after the resets of guards, by their numbers."""
        return self.guards.reset(y, u, [i - self._first_guard for i in fired])

    def modes_after(self, y: State, u: Array | None, mode: Mode, which: Margin) -> dict[int, int]:
        """Return the entries of the mode with which a switch is left where its margin is zero."""
        switch, side = which
        if self.rows is None or switch >= self.count:
            return {switch: side}
        return self.rows.modes_after(y, u, mode, switch, side)

    def renamed_slips(
        self, y: State, u: Array | None, mode: Mode, which: Margin | None = None
    ) -> dict[int, int]:
        """Return entries of the mode that give the same slips other names.

        At the start of a step, or where a margin is zero; empty where slips keep their names, or
        end.
        """
        switch, side = which or (None, 0)
        if self.rows is None or side or (switch is not None and switch >= self.count):
            return {}
        return self.rows.renamed_slips(y, u, mode, switch)

    def longest_step(self, y: State, u: Array | None, mode: Mode) -> float:
        """Return the length of a step in which directions of forces are followed [s]."""
        return math.inf if self.rows is None else self.rows.longest_step(y, u, mode)

    def project(self, y: State, u: Array | None, mode: Mode) -> State:
        """Return the state on what is active in a mode, moved only as its forces move it."""
        y = self.project_rows(y, mode)
        return y if self.surfaces is None else self.surfaces.project(y, u, mode)

    def project_rows(self, y: State, mode: Mode) -> State:
        """Return the state on the rows that are active in a mode."""
        if self.rows is None or 0 not in mode[: self.count]:
            return y
        return self.rows.project(y, mode)

    def open_gaps(self, y: State) -> State:
        """Return a state near by in which no gap is negative."""
        return y if self.rows is None else open_gaps(self.system, self.rows, self.gaps, y)

    def _stacked(self, rows: Array | None, surfaces: Array | None) -> Array:
        if rows is None or surfaces is None:
            either = surfaces if rows is None else rows
            return np.zeros(0) if either is None else either
        return np.concatenate((rows, surfaces))


class FieldDistances(NamedTuple):
    """Distances of the rows, and heights over the surfaces, at one state; None without any.

    Attributes:
        rows: Distances of the event-driven rows.
        heights: Heights over the switching surfaces, shape (m,).
    """

    rows: Distances | None
    heights: Array | None


def open_gaps(system: System, rows: EventRows, gaps: Sequence[int], y: State) -> State:
    """Return a state near by in which no gap is negative.

    A long displacement to the end of a gap opens loops by its square. So both are closed in turn;
    each pass squares the remaining error.

    Args:
        system: The system.
        rows: Its event-driven rows.
        gaps: Numbers of those that are gaps.
        y: State of what is integrated, on the bilateral rows.

    Raises:
        SolveError: Bilateral rows keep a gap negative, or cannot be closed.
    """
    closed: set[int] = set()
    for _ in range(_PASSES):
        distances = rows.measure(y).distances
        slack = rounding(y) if closed else 0.0
        negative = [i for i in gaps if distances[i] < -slack]
        if not negative and all(distances[i] <= slack for i in closed):
            return y
        closed.update(negative)
        mode = tuple(0 if i in closed else 1 for i in range(len(rows.names)))
        y = rows.project(y, mode, moves=False)
        if not system.bilateral.rows:
            return y
        y = assemble(system, y)
    if not negative:
        return y
    names = ", ".join(rows.names[i] for i in negative)
    raise SolveError(
        f"t = {y.t:.9g} s: the mechanism cannot be assembled on this side of {names}; start "
        "nearer to it, or look for constraints that contradict one another"
    )


def decide_modes(
    field: ModeField, y: State, u: Array | None, mode: Mode, undecided: Collection[int]
) -> dict[int, int]:
    """Return the modes in which some switches go on.

    Args:
        field: The switches of the system.
        y: State of what is integrated.
        u: Inputs there.
        mode: Mode of the other switches, which stay as they are.
        undecided: Numbers of the switches.

    Raises:
        SolveError: There is none, or several.
    """
    n = field.count
    rows = sorted(i for i in undecided if i < n)
    surfaces = sorted(i - n for i in undecided if i >= n)
    sides: tuple[int, ...]
    if field.surfaces is None or not surfaces:
        sides = () if field.rows is None else _decide_rows(field.rows, y, u, mode, rows)
    elif field.rows is None or not rows:
        response = field.surfaces.response(y, u, mode, surfaces)
        names = [field.surfaces.names[i] for i in surfaces]
        sides = mode_on(response.r[surfaces], response.D[surfaces], names)
    else:
        coupled = _coupled_response(field, y, u, mode, rows, surfaces)
        of_rows, of_surfaces = modes_of(coupled, [field.surfaces.names[i] for i in surfaces])
        sides = (*of_rows, *of_surfaces)
    return dict(zip([*rows, *(i + n for i in surfaces)], sides, strict=True))


def _decide_rows(
    rows: EventRows, y: State, u: Array | None, mode: Mode, chosen: Sequence[int]
) -> tuple[int, ...]:
    """Return the modes of rows beside surfaces that stay as they are."""
    if not chosen:
        return ()
    decided = rows.decided_mode(rows.solve(y, u, mode, chosen))
    return tuple(decided[i] for i in chosen)


def _coupled_response(
    field: ModeField,
    y: State,
    u: Array | None,
    mode: Mode,
    rows: Sequence[int],
    surfaces: Sequence[int],
) -> CoupledResponse:
    """Return the response of rows and surfaces to one another, from rows at their lower bounds."""
    event_rows, sliding = field.rows, field.surfaces
    assert event_rows is not None and sliding is not None
    if event_rows.contacts is not None and any(
        event_rows.reach[i] is Reach.FRICTION for i in rows
    ):
        names = ", ".join(field.names[i] for i in (*rows, *(field.count + i for i in surfaces)))
        raise SolveError(
            f"{names}: a contact with friction touches where a switching surface is reached; "
            "accepted: one of them at a time"
        )
    mode = tuple(1 if i in rows else side for i, side in enumerate(mode))
    response = sliding.response(y, u, mode, surfaces)
    a = sliding.system.lift(y, response.a)
    per_sign = [sliding.system.lift(y, response.a + b) - a for b in response.B.T]
    J, b, by_lam, lower, upper = event_rows.response(y, u, rows)
    per_lam = sliding.system.integrated(by_lam).T
    E = [sliding.rates_at(y, response.a + added)[surfaces] for added in per_lam]
    r, D = response.r[surfaces], response.D[surfaces]
    P = J.dot(np.array(per_sign).T)
    E_rows = (np.array(E) - r).T
    return CoupledResponse(
        J.dot(a) + b, J.dot(by_lam), P, r, E_rows, D, np.zeros(len(rows)), upper - lower
    )


def modes_of(response: CoupledResponse, names: Sequence[str]) -> tuple[Mode, Mode]:
    """Return the only modes in which rows and surfaces go on, rows first.

    The sides of the surfaces are tried one after the other, as by `switching_surfaces.mode_on`;
    the rows beside each choice are one complementarity problem.

    Args:
        response: Response of rows and surfaces to multipliers and signs.
        names: Names of the surfaces.

    Raises:
        SolveError: There are none, or several.
    """
    k = len(response.r)
    if k > MOST_SURFACES:
        raise SolveError(
            f"the motion is on {k} switching surfaces at once ({', '.join(names)}), but at most "
            f"{MOST_SURFACES} are accepted"
        )
    cases = sorted(itertools.product((0, 1, -1), repeat=k), key=lambda mode: -mode.count(0))
    solutions = [
        (solution, sides)
        for sides in cases
        if (solution := _solve_case(response, sides, names)) is not None
    ]
    where = f"switching surface {', '.join(names)} beside rows"
    if not solutions:
        raise SolveError(f"{where}: no solution goes on")
    (signs, rows), sides = solutions[0]
    if any(np.abs(other - signs).max() > _SAME for (other, _), _ in solutions[1:]):
        raise SolveError(f"{where}: the solution is not unique")
    return rows, sides


def _solve_case(
    response: CoupledResponse, sides: Mode, names: Sequence[str]
) -> tuple[Array, Mode] | None:
    """Return signs, and modes of the rows, for one choice of sides.

    None: the choice is inconsistent.
    """
    w0, A, P, r, E, D, lower, upper = response
    s = np.array(sides, dtype=np.float64)
    slides = s == 0.0
    try:
        per_lam = _sliding_signs(D, E, slides, names)
        free = _sliding_signs(D, (r + D.dot(s))[:, None], slides, names)[:, 0]
    except SolveError:
        return None
    P_on = P[:, slides]
    A_sliding, w_sliding = A + P_on.dot(per_lam), w0 + P.dot(s) + P_on.dot(free)
    if (A_sliding.diagonal() <= TIE * A.diagonal()).any():  # the surfaces hold these rows already
        return None
    lam = exchanged(A_sliding, w_sliding, lower, upper)
    if lam is None:
        return None
    s[slides] = free + per_lam.dot(lam)
    rates, terms = r + E.dot(lam) + D.dot(s), np.abs(r) + np.abs(D).sum(axis=1)
    are_signs = np.abs(s).max(initial=0.0) <= 1.0 + TIE
    leaves = (np.array(sides) * rates)[~slides] >= -TIE * terms[~slides]
    if not (are_signs and leaves.all()):
        return None
    w = A_sliding.dot(lam) + w_sliding
    slack = TIE * (np.abs(A_sliding).dot(np.abs(lam)) + np.abs(w_sliding))
    rows = np.where(w > slack, 1, np.where(w < -slack, -1, 0))
    return s, tuple(rows.tolist())


def _sliding_signs(D: Array, right: Array, slides: Array, names: Sequence[str]) -> Array:
    """Return signs of the surfaces that are slid on for rates that they end, one a column."""
    on = np.flatnonzero(slides).tolist()
    if not on:
        return np.zeros((0, right.shape[1]))
    block, titles = D[np.ix_(on, on)], [names[i] for i in on]
    columns = [equivalent_signs(column, block, titles) for column in right[on].T]
    return np.array(columns).T.reshape(len(on), right.shape[1])


class CoupledResponse(NamedTuple):
    """Response of rows and surfaces to multipliers lam and signs s.

        w = w0 + A lam + P s,   h' = r + E lam + D s

    Attributes:
        w0: Accelerations of the rows without both, shape (m,).
        A: Change of w by each multiplier, shape (m, m).
        P: Change of w by each sign, shape (m, k).
        r: Rates of the surfaces without both, shape (k,).
        E: Change of h' by each multiplier, shape (k, m).
        D: Change of h' by each sign, shape (k, k).
        lower: Smallest multipliers, shape (m,).
        upper: Largest multipliers, shape (m,).
    """

    w0: Array
    A: Array
    P: Array
    r: Array
    E: Array
    D: Array
    lower: Array
    upper: Array
