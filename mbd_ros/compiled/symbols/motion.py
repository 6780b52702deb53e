"""Accelerations of what a tier integrates, with rows that are on."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.rows import Coordinates, Entries, Rows, rows_of
from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.compiled.symbols.sparse_ldl import SparseLdl, order_of
from mbd_ros.compiled.symbols.tree.dynamics import LONG, TreeDynamics
from mbd_ros.compiled.symbols.tree.link_rotations import ZERO
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.delassus import configurations
from mbd_ros.core.state import Array, Mode, State

if TYPE_CHECKING:
    from mbd_ros.compiled.symbols.equations import Equations


# ---- motion -----------------------------------------------------------------------------------
# Accelerations of what a tier integrates, from dynamics, joint forces and rows.


SOFT = 1.0e-9  # of the usual size of a row: what is added to it where rows may be dependent
_AGAIN = 2  # solutions for what that leaves
_SHRUNK = 1.0e-4  # of what softness left: more is left where dependent rows contradict
_OPEN = 1.0e-13  # of 1 + the largest rate: rounding
_IDLE = 1.0e-11  # of multipliers that change no rate: what they may move
_ANY = 1.0e-6  # of a start, squared: what is left of it where multipliers change no rate
Pushes = Mapping[int, Mapping[int, Any]]
NO_PUSHES: Pushes = {}


class Solution(NamedTuple):
    """What holds at a state.

    Attributes:
        a: Accelerations of what is integrated, SX scalars.
        lam: Multipliers of the rows, SX scalars.
        pivots: What rows leave of themselves: -(J M^-1 J') without those before, SX scalars.
        sound: Positive where rows that may depend on one another are solved; no SX without any.
    """

    a: list[Any]
    lam: list[Any]
    pivots: list[Any]
    sound: Any = None


class Motion:
    """Motion of a mechanism with dependent joints, or with rows, or with neither.

    Args:
        dynamics: Of all joints.
        coordinates: What is integrated.
        tau: Generalized forces on all joints, SX scalars.
        rows: Those that hold.
        bias: The b of J a + b = 0, SX scalars, one a row.
        slack: As for `Held`.
        pushes: As for `Held`.
        soft: As for `Held`.
    """

    def __init__(
        self,
        dynamics: TreeDynamics,
        coordinates: Coordinates,
        tau: Sequence[Any],
        rows: Rows,
        bias: Sequence[Any],
        slack: Sequence[Any] = (),
        pushes: Pushes = NO_PUSHES,
        soft: Sequence[float] = (),
    ) -> None:
        self._dynamics, self._coordinates, self._tau = dynamics, coordinates, tau
        self._rows, self._bias = rows, bias
        self._more = slack, pushes, soft

    def solutions(self) -> list[Solution]:
        """The same accelerations by all forms that are worth a try."""
        c = self._coordinates
        is_open = not self._rows.J and c.nv == len(self._tau)
        found = []
        if is_open:
            found.append(Solution(self._dynamics.articulated(self._tau), [], []))
        if not is_open or c.nv <= LONG:
            found.append(self._by_factors())
        return found

    def _by_factors(self) -> Solution:
        c = self._coordinates
        drift = [ca.SX(one) for one in c.lifted([ZERO] * c.nv)] if c.moves_on else None
        h = self._dynamics.forces(drift)
        if drift is not None:
            h = self._dynamics.needed(drift)
        left = c.reduced([force - bias for force, bias in zip(self._tau, h, strict=True)])
        held = Held(c.reduced_matrix(self._dynamics.mass), self._rows, c.nv, *self._more)
        rates = [-one for one in self._bias]
        return held.balanced(left, rates) if any(self._more[2]) else held.solve(left, rates)


class Held:
    """Masses beside rows, factorised: M a - D' lam = f, J a + s lam = b.

    Args:
        mass: The lower triangle of M, SX scalars.
        rows: The rows.
        nv: Size of a velocity.
        slack: The s of each row, SX scalars; none where nothing is given.
        pushes: The D of rows by their numbers, where it is not J.
        soft: What is added to each s, so that rows may depend on one another, for `balanced`.
    """

    def __init__(
        self,
        mass: Entries,
        rows: Rows,
        nv: int,
        slack: Sequence[Any] = (),
        pushes: Pushes = NO_PUSHES,
        soft: Sequence[float] = (),
    ) -> None:
        self._nv, self._m, self._rows, self._mass = nv, len(rows.J), rows, mass
        self._slack = list(slack) or [ZERO] * self._m
        self._soft = list(soft) or [0.0] * self._m
        entries = dict(mass)
        for i, row in enumerate(rows.J):
            entries.update({(nv + i, j): value for j, value in row.items()})
            entries[nv + i, nv + i] = -(self._slack[i] + self._soft[i])
        upper = {(nv + i, j): one for i, push in pushes.items() for j, one in push.items()}
        edges = [at for at, value in (entries | upper).items() if not value.is_zero()]
        self._groups = [
            ([j for j in one if j < nv], [i - nv for i in one if i >= nv])
            for one in groups_of(edges, nv + self._m)
        ]
        waits = {i: {*row, *pushes.get(i - nv, ())} for i, row in enumerate(rows.J, nv)}
        order = order_of(edges, nv + self._m, waits)
        self._factors = SparseLdl(entries, order, upper)

    @property
    def size(self) -> int:
        """Operations of a solution, about."""
        return self._factors.size

    @property
    def pivots(self) -> list[Any]:
        """As those of a `Solution`."""
        return [-self._factors.pivots[i] for i in range(self._nv, self._nv + self._m)]

    def solve(self, forces: Sequence[Any], rates: Sequence[Any]) -> Solution:
        """Accelerations and multipliers for f and b."""
        x = self._factors.solve([*map(ca.SX, forces), *rates])
        return Solution(x[: self._nv], [-one for one in x[self._nv :]], self.pivots)

    def balanced(self, forces: Sequence[Any], rates: Sequence[Any]) -> Solution:
        """The same where rows may depend on one another: the least multipliers of those that do.

        What softness leaves of rates is solved for again. Multipliers that change no rate may move
        bodies by different slips; they are left out of those of each group of bodies, where all
        others are multiples of one. It is sound if nothing is left of rates then, and if no other
        ones move anything.
        """
        found, still = self.solve(forces, rates), [ZERO] * self._nv
        least = largest(self._left(found, rates))
        for _ in range(_AGAIN):
            more = self.solve(still, self._left(found, rates))
            pairs = zip(found[:2], more[:2], strict=True)
            a, lam = ([x + y for x, y in zip(*pair, strict=True)] for pair in pairs)
            found = found._replace(a=a, lam=lam)
        idle = self._idle(0)
        found = self._without(found, idle)
        most = _SHRUNK * least + _OPEN * (1.0 + largest(rates))
        is_open = largest(self._left(found, rates)) > most
        rest = self._without(self._idle(self._m), idle)
        moves = self._energy(rest.a) > _IDLE * _IDLE / SOFT * sum(self._soft)
        return found._replace(sound=ca.logic_not(ca.logic_or(is_open, moves)))

    def _idle(self, start: int) -> Solution:
        """Some multipliers that change no rate; next to none where rows are independent."""
        still, lam = [ZERO] * self._nv, [ca.SX(math.cos(1.0 + start + i)) for i in range(self._m)]
        for _ in range(2):  # leaves of any multipliers those that change no rate
            found = self.solve(still, [x * y for x, y in zip(self._soft, lam, strict=True)])
            lam = found.lam
        return found

    def _without(self, found: Solution, idle: Solution) -> Solution:
        """The part of a solution across idle multipliers, in each group of bodies."""
        a, lam = list(found.a), list(found.lam)
        for joints, rows in self._groups:
            counted = [i for i in rows if not self._slack[i].is_zero()]  # rigid ones are not
            size = sum((idle.lam[i] * idle.lam[i] for i in counted), ZERO)
            along = sum((idle.lam[i] * lam[i] for i in counted), ZERO)
            share = ca.if_else(size > _ANY, along / ca.fmax(size, _ANY), 0.0)
            for i in rows:
                lam[i] = lam[i] - share * idle.lam[i]
            for j in joints:
                a[j] = a[j] - share * idle.a[j]
        return found._replace(a=a, lam=lam)

    def _left(self, found: Solution, rates: Sequence[Any]) -> list[Any]:
        """What is left of b."""
        each = zip(self._rows.J, self._slack, found.lam, rates, strict=True)
        return [
            rate - slack * lam - sum((one * found.a[j] for j, one in row.items()), ZERO)
            for row, slack, lam, rate in each
        ]

    def _energy(self, a: Sequence[Any]) -> Any:
        """Twice the kinetic energy of velocities a."""
        return sum(
            ((2.0 if i != j else 1.0) * a[i] * one * a[j] for (i, j), one in self._mass.items()),
            ZERO,
        )


def groups_of(edges: Iterable[tuple[int, int]], size: int) -> list[list[int]]:
    """Numbers below a size that edges join."""
    group = list(range(size))
    for i, j in edges:
        one, other = group[i], group[j]
        if one != other:
            group = [one if each == other else each for each in group]
    return [[i for i in range(size) if group[i] == one] for one in sorted(set(group))]


def largest(values: Sequence[Any]) -> Any:
    """The largest size among SX scalars, 0 where there are none."""
    found = ZERO
    for value in values:
        found = ca.fmax(found, ca.fabs(value))
    return found


# ---- unilateral rows --------------------------------------------------------------------------
# Rows that give way, in a mode: those that are on are equations, the others known forces.


Margin = tuple[int, int]  # number of the row, and 1 or -1 where its multiplier meets a bound


class YieldingRows:
    """Rows that give way at events, in one mode.

    Args:
        equations: Of the system.
        mode: Begins with one entry a row: 0 on, 1 at the lower bound, -1 at the upper one.

    Attributes:
        on: Rows that are on, in what is integrated.
        bias: The b of J y'' + b = 0 of these.
        slack: The s of J y'' + s lam + b = 0, empty where all are none.
        pushing: What rows that are on push along otherwise than by J, by their numbers.
        touching: Normals of contacts among rows that may depend on one another.
        directed: Whether slips are fast enough to have a direction.

    Raises:
        Untraceable: Names what has no symbolic form.
    """

    slack: Sequence[Any] = ()
    pushing: Mapping[int, Mapping[int, Any]] = NO_PUSHES
    touching: Sequence[int] = ()
    directed: Any = 1.0

    def __init__(self, equations: "Equations", mode: Mode) -> None:
        self._ask(equations)
        if len(mode) < len(self._reach):
            raise Untraceable("rows that give way have a form in a mode only")
        self._mode = mode[: len(self._reach)]
        if not all(abs(way) <= 1 for way in self._mode) or any(
            not self._mode[i] and any(self._mode[i + 1 : i + 3]) for i in self._mu
        ):
            raise Untraceable("contacts that slip have no form in their mode")
        chosen = [i for i, way in enumerate(self._mode) if way == 0]
        self.on = self._whole.only(chosen).reduced(self._c)
        self.bias = [self._biased(i) for i in chosen]

    def _ask(self, equations: "Equations") -> None:
        """What all modes share."""
        system, k, x = equations.system, equations.k, equations.x
        if system.bounded is not None:
            name = system.bounded.constraints.rows[0].name
            raise Untraceable(f"row {name} is smoothed: its bounds are solved for everywhere")
        self._reach: Sequence[Reach] = () if system.exact is None else system.exact.reach
        given = () if system.exact is None else system.exact.solver.constraints.blocks
        blocks = equations.blocks(given)
        self._c = equations.coordinates
        self._mu = _frictions(blocks)
        self._whole = rows_of(blocks, k, x)
        self._conditions = [
            _with_gains(self._whole, i, equations.velocity, gains)
            for i, gains in enumerate(_gains(blocks))
        ]
        self._lower, self._upper = _bounds(blocks, k, x)
        self.slots = [slot for b in blocks for slot in range(b.slots.start, b.slots.stop)]

    def _biased(self, i: int) -> Any:
        drift = self._c.drift
        own = (value * plain(drift[j]) for j, value in self._whole.J[i].items())
        return self._conditions[i] + sum(own)

    def gaps(self) -> dict[int, Any]:
        """What one-sided rows of positions keep from becoming negative, by their slots.

        Raises:
            Untraceable: Another row, whose force jumps with a slip or a limit.
        """
        found = {}
        for i, reach in enumerate(self._reach):
            if reach is Reach.GAP:
                found[self.slots[i]] = self._whole.g[i]
            elif reach is not Reach.FRICTION or (i - 1 not in self._mu and i - 2 not in self._mu):
                raise Untraceable("its force jumps, and has no slope there")
        return found

    def multipliers(self, lam: Sequence[Any]) -> list[Any]:
        """Of all these rows, SX scalars, from those of the rows that are on."""
        solved = iter(lam)
        return [
            next(solved) if not way else (self._lower if way == 1 else self._upper)[i]
            for i, way in enumerate(self._mode)
        ]

    def pushes(self, lam: Sequence[Any]) -> list[Any]:
        """Generalized forces of multipliers on all joints, SX scalars."""
        tau = [ZERO] * len(self._c.v)
        for row, force in zip(self._whole.J, lam, strict=True):
            for j, value in row.items():
                tau[j] = tau[j] + value * force
        return tau

    def known(self) -> list[Any]:
        """Forces of rows at a bound, as `pushes`."""
        return self.pushes(self.multipliers([ZERO] * len(self.on.J)))

    def margins(self, a: Sequence[Any], lam: Sequence[Any], v: Sequence[Any]) -> dict[Margin, Any]:
        """What is positive while the mode goes on, by row, as `ModeField.margins`.

        Args:
            a: Accelerations of all joints, SX scalars.
            lam: Multipliers of these rows.
            v: Velocity of all joints.
        """
        found: dict[Margin, Any] = {}
        rates = self._whole.velocities(v)
        for i, (way, reach) in enumerate(zip(self._mode, self._reach, strict=True)):
            if reach is Reach.FRICTION:
                if not way and i - 1 in self._mu:
                    found[i, 1] = self._grip(i - 1, lam)
            elif not way:
                if not is_open(self._lower[i]):
                    found[i, 1] = lam[i] - self._lower[i]
                if not is_open(self._upper[i]):
                    found[i, -1] = self._upper[i] - lam[i]
            elif reach is Reach.DEMAND:
                left = sum((value * a[j] for j, value in self._whole.J[i].items()), ZERO)
                found[i, 0] = way * (left + self._conditions[i])
            else:
                found[i, 0] = way * (self._whole.g[i] if reach is Reach.GAP else rates[i])
        return found

    def _grip(self, normal: int, lam: Sequence[Any]) -> Any:
        """What is left of friction that sticks to its largest, by the row of the normal."""
        push, x, y = lam[normal : normal + 3]
        return self._mu[normal] * push - ca.sqrt(x * x + y * y)


def _gains(blocks: Sequence[Any]) -> list[tuple[float, float]]:
    return [
        (plain(kp), plain(kd)) for block in blocks for kp, kd in zip(*block.gains, strict=True)
    ]


def _frictions(blocks: Sequence[Any]) -> dict[int, float]:
    """Coefficients of contacts, by the rows of their normals."""
    first, found = 0, dict[int, float]()
    for block in blocks:
        found |= {cone.slots.start: float(cone.mu) for cone in block.cones(first)}
        first += len(block.rows)
    return found


def _with_gains(rows: Rows, i: int, v: Sequence[Any], gains: tuple[float, float]) -> Any:
    return rows.only([i]).conditions(v, gains)[0]


def _bounds(blocks: Sequence[Any], k: Any, x: Any) -> tuple[list[Any], list[Any]]:
    """Smallest and largest multipliers of all rows."""
    found: tuple[list[Any], list[Any]] = [], []
    for block in blocks:
        if block.law.kind is Kind.CONE:  # friction depends on the normal
            found[0].extend([ZERO] * len(block.rows))
            found[1].extend([ca.SX(math.inf), ZERO, ZERO] * (len(block.rows) // 3))
            continue
        with tracing(block.part):
            for values, given in zip(found, block.limits(k, x), strict=True):
                every = k.spread(given, len(block.rows))
                values.extend(ca.SX(plain(one)) for one in every)
    return found


def is_open(bound: Any) -> bool:
    """Whether a bound is none."""
    return bool(bound.is_constant()) and math.isinf(float(bound))


# ---- row rank ---------------------------------------------------------------------------------
# Whether rows are independent enough to be solved for, and what lets some of them depend.


# How large pivots of rows usually are, so that one which vanishes shows.


def usual_pivots(system: Any, symbols: dict[str, Any], pivots: Any, switches: int = 0) -> Array:
    """Medians over configurations all over the range of the joints, at rest, shape (m,).

    Args:
        system: The system.
        symbols: Arguments by letter.
        pivots: Expressions of configuration and time.
        switches: How many of the rows, the last ones, have an entry of a mode behind the
            parameters: each is measured while the others of these are off.
    """
    asked = ca.Function("pivots", [symbols[key] for key in "tqvzup"], [pivots])
    rest = [np.zeros(symbols[key].shape[0]) for key in "vzup"]
    still, first = np.zeros(system.model.nv), len(rest[3]) - switches
    every = [system.reduce(State(0.0, q, still)).q for q in configurations(system.robot)]

    def medians() -> Array:
        found = np.array([np.array(asked(0.0, q, *rest)).ravel() for q in every])
        kept = np.where(np.isfinite(found), found, 0.0)
        return np.asarray(np.median(kept, axis=0))

    if switches:
        rest[3][first:] = 1.0
    usual = medians()
    for i in range(switches):
        rest[3][first:] = np.arange(switches) != i
        usual[i - switches] = medians()[i - switches]
    return usual


def health(equations: "Equations", solution: Solution, *, switches: bool = False) -> Any:
    """The smallest pivot of the rows over its usual size; 0 where a solution is not sound.

    Args:
        equations: Of the system.
        solution: Beside rows, those that give way last.
        switches: Whether there are any of these whose mode is an argument.
    """
    e, found = equations, ca.SX(1.0)
    count = e.switches if switches else 0
    off = e.slack if count else [ZERO] * len(solution.pivots)
    if solution.sound is not None:
        found = ca.fmin(solution.sound, e.yielding.directed)
    if solution.pivots:
        pivots = ca.vertcat(*solution.pivots)
        usual = usual_pivots(e.system, e.symbols, pivots, count)
        is_soft = [False] * len(off) if solution.sound is None else [one > 0.0 for one in e.soft]
        each = zip(solution.pivots, off, np.asarray(usual).tolist(), is_soft, strict=True)
        for pivot, slack, size in (one[:3] for one in each if not one[3]):
            share = pivot * (1.0 / size if size else 0.0)
            found = ca.fmin(found, share + slack * (1.0 - share))
    return found


def softness(equations: "Equations") -> list[float]:
    """What is added to the s of contacts, which may depend on one another; as `Held` takes it.

    Args:
        equations: Of the system.
    """
    e, chosen = equations, equations.yielding.touching
    if not chosen:
        return []
    mass = e.coordinates.reduced_matrix(e.dynamics[0].mass)
    pivots = ca.vertcat(*Held(mass, e.acting, e.nv, e.slack).pivots)
    sizes = np.abs(usual_pivots(e.system, e.symbols, pivots, e.switches)[e.mh :]).tolist()
    found = [0.0] * len(e.slack)
    for i in chosen:
        most = max(sizes[i : i + 3]) or 1.0
        found[e.mh + i : e.mh + i + 3] = [SOFT * most] * 3
    return found
