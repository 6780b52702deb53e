"""A system in one mode at a time: rows of exact events, then surfaces of switching forces."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contact_modes.event_rows import ExactRows
from mbd_ros.core.contact_modes.row_distances import Reach, rounding
from mbd_ros.core.dynamics.system import Accelerator, System
from mbd_ros.core.optimization.box_qp import exchanged
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.state import Mode as StateMode
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
# A switch, and 0 where it is reached; 1 or -1 where it is left in that direction.
Margin = tuple[int, int]
_SAME = 1.0e-6  # signs that give the same motion


class ModeField:
    """The switches of a system, one entry of a mode each.

    A switch is off beside its surface or gap, in the direction 1 or -1 that its mode says, and on
    at mode 0. It leaves in the direction 1 or -1 once its multiplier passes a bound.

    Args:
        with_surfaces: Whether surfaces of switching forces are switches, too; their forces go by
            the signs of the heights otherwise.

    Attributes:
        system: The system in its modes.
        names: Of the switches: rows as their multipliers, then surfaces; then of guards of parts.
        guards: Those of parts; their numbers follow those of the switches.
        rows: The exact rows; None without any.
        has_contacts: Whether contacts with friction are among them.
        surfaces: The surfaces in their modes; None without any.
        count: Number of the exact rows.
        mode: The present one.

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
        self.rows = self.system.exact
        self.has_contacts = self.rows is not None and self.rows.contacts is not None
        names = () if self.rows is None else self.rows.names
        self.count = len(names)
        self.names = names if self.surfaces is None else (*names, *self.surfaces.names)
        reach = () if self.rows is None else self.rows.reach
        self._demands = [i for i, one in enumerate(reach) if one is Reach.DEMAND]
        self._frictions = [i for i, one in enumerate(reach) if one is Reach.FRICTION]
        self._no_height = {*self._demands, *self._frictions}
        self._slips = [i for i, one in enumerate(reach) if one is Reach.SLIP]
        self.gaps = [i for i, one in enumerate(reach) if one is Reach.GAP]
        self._mode: StateMode = (1,) * len(self.names)
        self.guards = PartGuards(self.system)
        self._first, self._sides = len(self.names), [0] * len(self.guards.names)
        self.names = (*self.names, *self.guards.names)

    @property
    def mode(self) -> StateMode:
        """One entry a switch."""
        return self._mode

    @mode.setter
    def mode(self, mode: StateMode) -> None:
        self._mode = mode
        if self.surfaces is not None:
            self.surfaces.beside = mode[: self.count]
            self.surfaces.mode = mode[self.count :]

    @property
    def drives(self) -> list[int]:
        """Drives at their limit, whose margins are accelerations."""
        return [i for i in self._demands if self._mode[i]]

    @property
    def on(self) -> list[int]:
        """Switches that are on."""
        return [i for i, way in enumerate(self._mode) if way == 0]

    def accelerator(self) -> Accelerator:
        """That of the present mode."""
        if self.surfaces is None:
            return self.system.accelerator(self._mode)
        return self.surfaces.accelerator()

    def heights(self, y: State) -> Array:
        """Gaps, slip velocities and heights; 1 for drives, which have none."""
        return self._stacked(
            None if self.rows is None else self.rows.heights(y),
            None if self.surfaces is None else self.surfaces.heights(y),
        )

    def rates(self, y: State, u: Array | None) -> Array:
        """The rates of the heights in the present mode; 0 for drives."""
        rates = None
        if self.rows is not None:
            rates = self.rows.approach(y)
            if any(self._mode[i] for i in self._slips):
                rates[self._slips] = self.rows.rates_left(y, u, self._mode)[self._slips]
            rates[list(self._no_height)] = 0.0
        surfaces = self.surfaces
        return self._stacked(rates, None if surfaces is None else surfaces.rates(y, u))

    def near(self, y: State) -> set[int]:
        """Switches that may be on to within rounding; always the drives."""
        found: set[int] = set()
        if self.rows is not None:
            found.update(self.rows.ways(y)[1])
        if self.surfaces is not None:
            at = np.flatnonzero(np.abs(self.surfaces.heights(y)) <= rounding(y))
            found.update((at + self.count).tolist())
        return found

    def close(self, y: State, u: Array | None) -> set[int]:
        """Switches whose height is none to within rounding, and guards that are zero."""
        sizes = np.concatenate((self.heights(y), self.guards.values(y, u, self._mode)))
        return set(np.flatnonzero(np.abs(sizes) <= rounding(y)).tolist())

    def watch(self, y: State, u: Array | None, left: Collection[int]) -> None:
        """Find out on which sides guards of parts act in the step from a state on.

        Args:
            y: State from which it starts.
            left: Numbers that were zero just now.
        """
        if self.guards.names:
            values = self.guards.values(y, u, self._mode)
            own = {i - self._first for i in left}
            self._sides = self.guards.sides(values, rounding(y), self._mode, own)

    def unwatch(self, guard: int) -> None:
        """Let a guard not act in this step; by its number."""
        self._sides[guard - self._first] = 0

    @property
    def watched(self) -> list[int]:
        """Numbers of the guards that act in this step."""
        return [self._first + i for i, side in enumerate(self._sides) if side]

    def fired(self, y: State, u: Array | None, guard: int) -> list[int]:
        """Guards that act and are zero together with one of them."""
        if guard < self._first and not self.watched:
            return []
        values = np.abs(self.guards.values(y, u, self._mode)) <= rounding(y)
        return [i for i in self.watched if i == guard or values[i - self._first]]

    def idle(self, y: State, fired: Collection[int]) -> list[int]:
        """Those of guards that are zero which do not act there, by their condition."""
        return [i for i in fired if not self.guards.acts(y, i - self._first)]

    def ending(self, fired: Collection[int]) -> list[int]:
        """Those of guards that end a phase."""
        return [i for i in fired if self.guards.guards[i - self._first].ends]

    def begin(self, y: State) -> None:
        """Take the mode that the heights of a state say."""
        rows = () if self.rows is None else self.rows.ways(y)[0]
        if self.surfaces is not None:
            sides = np.where(self.surfaces.heights(y) < 0.0, -1, 1)
            rows = (*rows, *sides.tolist())
        self.mode = rows

    def margin(self, y: State, u: Array | None, which: Margin) -> float:
        """One of the margins; a height alone asks for no acceleration."""
        switch, way = which
        if way or switch in self._no_height or switch >= self._first:
            return self.margins(y, u)[which]
        return float(self._mode[switch] * self.heights(y)[switch])

    def margins(self, y: State, u: Array | None) -> dict[Margin, float]:
        """What is positive while the present mode goes on."""
        heights = self.heights(y).tolist()
        margins = {
            (i, 0): way * heights[i]
            for i, way in enumerate(self._mode)
            if way and i not in self._no_height
        }
        n, rows = self.count, self.rows
        on = [i for i in range(n) if not self._mode[i]]
        if rows is not None and (on or self._demands):
            rows.solve(y, u, self._mode)
            for i in (i for i in on if i not in self._frictions):
                if rows.lower[i] > -np.inf:
                    margins[i, 1] = float(rows.lam[i] - rows.lower[i])
                if rows.upper[i] < np.inf:
                    margins[i, -1] = float(rows.upper[i] - rows.lam[i])
            for i in self._demands:
                if self._mode[i]:
                    margins[i, 0] = float(self._mode[i] * rows.left[i])
            margins.update(rows.friction(y, self._mode))
        surfaces = self.surfaces
        if surfaces is not None and surfaces.sliding:
            for i, s in zip(surfaces.sliding, surfaces.signs(y, u).tolist(), strict=True):
                margins[n + i, 1], margins[n + i, -1] = 1.0 - s, 1.0 + s
        if self.watched:
            values = self.guards.values(y, u, self._mode).tolist()
            for i in self.watched:
                margins[i, 0] = self._sides[i - self._first] * values[i - self._first]
        return margins

    def reset(self, y: State, u: Array | None, fired: Collection[int]) -> State:
        """The state after the resets of guards, by their numbers."""
        return self.guards.reset(y, u, [i - self._first for i in fired])

    def leaving(self, y: State, u: Array | None, which: Margin) -> dict[int, int]:
        """The modes with which a switch is left where its margin is zero."""
        switch, way = which
        if self.rows is None or switch >= self.count:
            return {switch: way}
        return self.rows.leaving(y, u, self._mode, switch, way)

    def renamed(self, y: State, u: Array | None, which: Margin | None = None) -> dict[int, int]:
        """Modes that name the same motion anew, at the start of a step or where a margin is zero.

        Empty where a motion keeps its name, or ends.
        """
        switch, way = which or (None, 0)
        if self.rows is None or way or (switch is not None and switch >= self.count):
            return {}
        return self.rows.renamed(y, u, self._mode, switch)

    def longest(self, y: State, u: Array | None) -> float:
        """Length of a step in which directions of forces are followed [s]."""
        return math.inf if self.rows is None else self.rows.longest(y, u, self._mode)

    def onto(self, y: State, u: Array | None) -> State:
        """The state on what is on, moved only as the forces of that move it."""
        y = self.onto_rows(y)
        return y if self.surfaces is None else self.surfaces.onto(y, u)

    def onto_rows(self, y: State) -> State:
        """The state on the rows that are on."""
        if self.rows is None or 0 not in self._mode[: self.count]:
            return y
        return self.rows.onto(y, self._mode)

    def inside(self, y: State) -> State:
        """A state near by in which no gap is beyond its end; `inside`."""
        return y if self.rows is None else inside(self.system, self.rows, self.gaps, y)

    def _stacked(self, rows: Array | None, surfaces: Array | None) -> Array:
        if rows is None or surfaces is None:
            given = surfaces if rows is None else rows
            return np.zeros(0) if given is None else given
        return np.concatenate((rows, surfaces))


def inside(system: System, rows: ExactRows, gaps: Sequence[int], y: State) -> State:
    """A state near by in which no gap is beyond its end.

    A long way to the end of a gap opens loops by its square. So both are closed in turn; each pass
    squares what is left.

    Args:
        rows: Its exact rows.
        gaps: Numbers of those that are gaps.
        y: State of what is integrated, on the bilateral rows.

    Raises:
        SolveError: Bilateral rows keep a gap beyond its end, or cannot be closed.
    """
    ended: set[int] = set()
    for _ in range(_PASSES):
        heights = rows.heights(y)
        slack = rounding(y) if ended else 0.0
        beyond = [i for i in gaps if heights[i] < -slack]
        if not beyond and all(heights[i] <= slack for i in ended):
            return y
        ended.update(beyond)
        mode = tuple(0 if i in ended else 1 for i in range(len(rows.names)))
        y = rows.onto(y, mode, moves=False)
        if not system.held.rows:
            return y
        y = assemble(system, y)
    if not beyond:
        return y
    names = ", ".join(rows.names[i] for i in beyond)
    raise SolveError(
        f"t = {y.t:.9g} s: the mechanism cannot be assembled on this side of {names}; start "
        "nearer to it, or look for constraints that contradict one another"
    )


def decided(field: ModeField, y: State, u: Array | None, on: Collection[int]) -> dict[int, int]:
    """The modes in which switches go on.

    Args:
        field: The system in its modes.
        y: State of what is integrated.
        on: The switches; the others stay as they are.

    Raises:
        SolveError: There is none, or several.
    """
    n = field.count
    rows = sorted(i for i in on if i < n)
    surfaces = sorted(i - n for i in on if i >= n)
    ways: tuple[int, ...]
    if field.surfaces is None or not surfaces:
        ways = () if field.rows is None else _of_rows(field, field.rows, y, u, rows)
    elif field.rows is None or not rows:
        answer = field.surfaces.answer(y, u, surfaces)
        names = [field.surfaces.names[i] for i in surfaces]
        ways = mode_on(answer.r[surfaces], answer.D[surfaces], names)
    else:
        given = _together(field, y, u, rows, surfaces)
        of_rows, of_surfaces = modes_of(given, [field.surfaces.names[i] for i in surfaces])
        ways = (*of_rows, *of_surfaces)
    return dict(zip([*rows, *(i + n for i in surfaces)], ways, strict=True))


def _of_rows(
    field: ModeField, rows: ExactRows, y: State, u: Array | None, chosen: Sequence[int]
) -> tuple[int, ...]:
    """Modes of exact rows beside surfaces that stay as they are."""
    if not chosen:
        return ()
    rows.solve(y, u, field.mode, chosen)
    found = rows.found()
    return tuple(found[i] for i in chosen)


def _together(
    field: ModeField, y: State, u: Array | None, rows: Sequence[int], surfaces: Sequence[int]
) -> Together:
    """How rows and surfaces answer one another, from rows at their lower bounds on."""
    exact, sliding, mode = field.rows, field.surfaces, field.mode
    assert exact is not None and sliding is not None
    if exact.contacts is not None and any(exact.reach[i] is Reach.FRICTION for i in rows):
        names = ", ".join(field.names[i] for i in (*rows, *(field.count + i for i in surfaces)))
        raise SolveError(
            f"{names}: a contact with friction touches where a switching surface is reached; "
            "accepted: one of them at a time"
        )
    field.mode = tuple(1 if i in rows else way for i, way in enumerate(mode))
    try:
        answer = sliding.answer(y, u, surfaces)
        a = sliding.system.lift(y, answer.a)
        per_sign = [sliding.system.lift(y, answer.a + b) - a for b in answer.B.T]
        J, b, response = exact.answer(y, u, rows)
        per_lam = sliding.system.integrated(response).T
        E = [sliding.rates_at(y, answer.a + more)[surfaces] for more in per_lam]
    finally:
        field.mode = mode
    r, D = answer.r[surfaces], answer.D[surfaces]
    room = exact.upper[rows] - exact.lower[rows]
    P = J.dot(np.array(per_sign).T)
    E_rows = (np.array(E) - r).T
    return Together(J.dot(a) + b, J.dot(response), P, r, E_rows, D, np.zeros(len(rows)), room)


def modes_of(given: Together, names: Sequence[str]) -> tuple[Mode, Mode]:
    """The only modes in which rows and surfaces go on, rows first.

    The sides of the surfaces are tried one after the other, as by `switching_surfaces.mode_on`;
    the rows beside each choice are one complementarity problem.

    Args:
        given: How they answer.
        names: Of the surfaces.

    Raises:
        SolveError: There are none, or several.
    """
    k = len(given.r)
    if k > MOST_SURFACES:
        raise SolveError(f"{k} switching surfaces at once ({', '.join(names)})")
    cases = sorted(itertools.product((0, 1, -1), repeat=k), key=lambda mode: -mode.count(0))
    found = [
        (answer, ways) for ways in cases if (answer := _answer(given, ways, names)) is not None
    ]
    where = f"switching surface {', '.join(names)} beside rows"
    if not found:
        raise SolveError(f"{where}: no solution goes on")
    (signs, rows), ways = found[0]
    if any(np.abs(other - signs).max() > _SAME for (other, _), _ in found[1:]):
        raise SolveError(f"{where}: the solution is not unique")
    return rows, ways


def _answer(given: Together, ways: Mode, names: Sequence[str]) -> tuple[Array, Mode] | None:
    """Signs and modes of the rows for one choice of sides; None where it contradicts itself."""
    w0, A, P, r, E, D, lower, upper = given
    s = np.array(ways, dtype=np.float64)
    slides = s == 0.0
    try:
        per_lam = _solved(D, E, slides, names)
        free = _solved(D, (r + D.dot(s))[:, None], slides, names)[:, 0]
    except SolveError:
        return None
    P_on = P[:, slides]
    whole, rest = A + P_on.dot(per_lam), w0 + P.dot(s) + P_on.dot(free)
    if (whole.diagonal() <= TIE * A.diagonal()).any():  # rows that these surfaces hold already
        return None
    lam = exchanged(whole, rest, lower, upper)
    if lam is None:
        return None
    s[slides] = free + per_lam.dot(lam)
    rates, terms = r + E.dot(lam) + D.dot(s), np.abs(r) + np.abs(D).sum(axis=1)
    held = np.abs(s).max(initial=0.0) <= 1.0 + TIE
    leaves = (np.array(ways) * rates)[~slides] >= -TIE * terms[~slides]
    if not (held and leaves.all()):
        return None
    w, slack = whole.dot(lam) + rest, TIE * (np.abs(whole).dot(np.abs(lam)) + np.abs(rest))
    rows = np.where(w > slack, 1, np.where(w < -slack, -1, 0))
    return s, tuple(rows.tolist())


def _solved(D: Array, right: Array, slides: Array, names: Sequence[str]) -> Array:
    """Signs of the surfaces that are slid on for rates that they have to end, one a column."""
    on = np.flatnonzero(slides).tolist()
    if not on:
        return np.zeros((0, right.shape[1]))
    block, titles = D[np.ix_(on, on)], [names[i] for i in on]
    columns = [equivalent_signs(column, block, titles) for column in right[on].T]
    return np.array(columns).T.reshape(len(on), right.shape[1])


class Together(NamedTuple):
    """How rows and surfaces answer multipliers lam and signs s.

        w = w0 + A lam + P s,   h' = r + E lam + D s

    Attributes:
        w0: Shape (m,).
        A: Shape (m, m).
        P: Shape (m, k).
        r: Shape (k,).
        E: Shape (k, m).
        D: Shape (k, k).
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
