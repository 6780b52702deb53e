"""Unilateral rows, whose multipliers have bounds, in one mode or in all modes at once.

A mode has one entry m a row: 0 where its equation J a + b = 0 holds, 1 or -1 where its multiplier
stands at the lower or upper bound and is a known force. Where the mode is an argument, one
compiled function serves all modes: m^2 switches between the equation and nothing,

    (1 - m^2) (J a + b) + m^2 lam = 0

Normal and tangents of a contact are three rows. The mode of the tangents of one that slips is two
odd numbers along the slip, its name; see `core.contact_modes.slip_directions`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.constrained_motion import NO_PUSHES, Rows, largest, rows_of
from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.compiled.symbols.symbolic_system import SymbolicSystem
from mbd_ros.compiled.symbols.tree.link_rotations import ONE, ZERO
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contact_modes import slip_directions
from mbd_ros.core.contact_modes.contact_modes import CHANGE, PASSED
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.state import Mode
from mbd_ros.core.thresholds import TINY

Margin = tuple[int, int]  # number of the row, and 1 or -1 where its multiplier meets a bound
_ENDLESS = 1.0  # a margin that never ends
_LONG = 1.0e9  # a step that no slip makes shorter [s]


class UnilateralRows:
    """Unilateral rows in one mode.

    Args:
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

    def __init__(self, system: SymbolicSystem, mode: Mode) -> None:
        self._trace_rows(system)
        if len(mode) < len(self._reach):
            raise Untraceable(
                "unilateral and bounded constraints have a symbolic form only in a given mode"
            )
        self._mode = mode[: len(self._reach)]
        if not all(abs(entry) <= 1 for entry in self._mode) or any(
            not self._mode[i] and any(self._mode[i + 1 : i + 3]) for i in self._mu
        ):
            raise Untraceable("contacts that slip have no form in their mode")
        chosen = [i for i, entry in enumerate(self._mode) if entry == 0]
        self.on = self._rows.only(chosen).reduced(self._coordinates)
        self.bias = [self._biased(i) for i in chosen]

    def _trace_rows(self, system: SymbolicSystem) -> None:
        """Trace what all modes share."""
        bounded, event_driven = system.system.bounded, system.system.event_rows
        if bounded is not None:
            name = bounded.constraints.rows[0].name
            raise Untraceable(f"row {name} is smoothed: its bounds are solved for everywhere")
        self._reach: Sequence[Reach] = () if event_driven is None else event_driven.reach
        symbolic_blocks = () if event_driven is None else event_driven.solver.constraints.blocks
        blocks = system.blocks(symbolic_blocks)
        self._coordinates = system.coordinates
        self._mu = _frictions(blocks)
        self._rows = rows_of(blocks, system.k, system.x)
        gains = [
            (plain(kp), plain(kd)) for block in blocks for kp, kd in zip(*block.gains, strict=True)
        ]
        self._conditions = [
            self._rows.only([i]).conditions(system.velocity, pair)[0]
            for i, pair in enumerate(gains)
        ]
        self._lower, self._upper = _bounds(blocks, system.k, system.x)
        self.slots = [slot for b in blocks for slot in range(b.slots.start, b.slots.stop)]

    def _biased(self, i: int) -> Any:
        drift = self._coordinates.drift
        terms = (value * plain(drift[j]) for j, value in self._rows.J[i].items())
        return self._conditions[i] + sum(terms)

    def gaps(self) -> dict[int, Any]:
        """Return the gaps, which one-sided rows keep from becoming negative, by their slots.

        Raises:
            Untraceable: Another row, whose force jumps with a slip or a limit.
        """
        gaps = {}
        for i, reach in enumerate(self._reach):
            if reach is Reach.GAP:
                gaps[self.slots[i]] = self._rows.g[i]
            elif reach is not Reach.FRICTION or (i - 1 not in self._mu and i - 2 not in self._mu):
                raise Untraceable("its force jumps, and has no slope there")
        return gaps

    def multipliers(self, lam: Sequence[Any]) -> list[Any]:
        """Return the multipliers of all rows, SX scalars, from those of active rows."""
        solved = iter(lam)
        return [
            next(solved) if not entry else (self._lower if entry == 1 else self._upper)[i]
            for i, entry in enumerate(self._mode)
        ]

    def pushes(self, lam: Sequence[Any]) -> list[Any]:
        """Generalized forces of multipliers on all joints, SX scalars."""
        tau = [ZERO] * len(self._coordinates.v)
        for row, force in zip(self._rows.J, lam, strict=True):
            for j, value in row.items():
                tau[j] = tau[j] + value * force
        return tau

    def known(self) -> list[Any]:
        """Forces of rows at a bound, as `pushes`."""
        return self.pushes(self.multipliers([ZERO] * len(self.on.J)))

    def margins(self, a: Sequence[Any], lam: Sequence[Any], v: Sequence[Any]) -> dict[Margin, Any]:
        """Return the margins, positive while the mode lasts, by row, see `ModeField.margins`.

        Args:
            a: Accelerations of all joints, SX scalars.
            lam: Multipliers of these rows.
            v: Velocity of all joints.
        """
        margins: dict[Margin, Any] = {}
        rates = self._rows.velocities(v)
        for i, (entry, reach) in enumerate(zip(self._mode, self._reach, strict=True)):
            if reach is Reach.FRICTION:
                if not entry and i - 1 in self._mu:
                    margins[i, 1] = self._grip(i - 1, lam)
            elif not entry:
                if not is_open(self._lower[i]):
                    margins[i, 1] = lam[i] - self._lower[i]
                if not is_open(self._upper[i]):
                    margins[i, -1] = self._upper[i] - lam[i]
            elif reach is Reach.DEMAND:
                left = sum((value * a[j] for j, value in self._rows.J[i].items()), ZERO)
                margins[i, 0] = entry * (left + self._conditions[i])
            else:
                margins[i, 0] = entry * (self._rows.g[i] if reach is Reach.GAP else rates[i])
        return margins

    def _grip(self, normal: int, lam: Sequence[Any]) -> Any:
        """Return the margin of sticking friction to its limit, by the row of the normal."""
        push, x, y = lam[normal : normal + 3]
        return self._mu[normal] * push - ca.sqrt(x * x + y * y)


def _frictions(blocks: Sequence[Any]) -> dict[int, float]:
    """Coefficients of contacts, by the rows of their normals."""
    first, coefficients = 0, dict[int, float]()
    for block in blocks:
        coefficients |= {cone.slots.start: float(cone.mu) for cone in block.cones(first)}
        first += len(block.rows)
    return coefficients


def _bounds(blocks: Sequence[Any], k: Any, x: Any) -> tuple[list[Any], list[Any]]:
    """Smallest and largest multipliers of all rows."""
    bounds: tuple[list[Any], list[Any]] = [], []
    for block in blocks:
        if block.law.kind is Kind.CONE:  # friction depends on the normal
            bounds[0].extend([ZERO] * len(block.rows))
            bounds[1].extend([ca.SX(math.inf), ZERO, ZERO] * (len(block.rows) // 3))
            continue
        with tracing(block.part):
            for values, limits in zip(bounds, block.limits(k, x), strict=True):
                every = k.spread(limits, len(block.rows))
                values.extend(ca.SX(plain(bound)) for bound in every)
    return bounds


def is_open(bound: Any) -> bool:
    """Whether a bound is none."""
    return bool(bound.is_constant()) and math.isinf(float(bound))


class SwitchedRows(UnilateralRows):
    """Unilateral rows in every mode.

    Args:
        ways: The mode, one SX scalar a row.

    Raises:
        Untraceable: Names what has no symbolic form.
    """

    def __init__(self, system: SymbolicSystem, mode: Sequence[Any]) -> None:
        self._trace_rows(system)
        self._mode_entries = mode
        self._slips = self._slipping(system.velocity)
        tangents = {i + j for i in self._slips for j in (1, 2)}
        self._off = [
            entry != 0.0 if i in tangents else entry * entry for i, entry in enumerate(mode)
        ]
        self.slack, self.touching = self._off, list(self._slips)
        self._open = self._rows.reduced(self._coordinates)
        self.on = self.masked(range(len(mode)))
        self.bias = [(1.0 - off) * self._biased(i) for i, off in enumerate(self._off)]
        self._rubs = {i: self._rub(i, slip) for i, slip in self._slips.items()}
        self.pushing = {i: self._pushed(i, rub) for i, rub in self._rubs.items()}
        for slip in self._slips.values():
            self.directed = ca.fmin(self.directed, slip.is_directed)

    def _slipping(self, v: Sequence[Any]) -> dict[int, Slip]:
        """Contacts by the rows of their normals."""
        rates, speed = self._rows.velocities(v), largest(v) if self._mu else ZERO
        slips = {}
        for i in self._mu:
            name, along = self._mode_entries[i + 1 : i + 3], rates[i + 1 : i + 3]
            slips[i] = slip_of(
                self._mode_entries[i], (name[0], name[1]), (along[0], along[1]), speed
            )
        return slips

    def _rub(self, i: int, slip: Slip) -> tuple[Any, Any]:
        """Friction against a slip, of the force of its normal."""
        x, y = slip.direction
        return self._mu[i] * slip.is_on * x, self._mu[i] * slip.is_on * y

    def _pushed(self, i: int, rub: tuple[Any, Any]) -> dict[int, Any]:
        """Return the force direction of a contact, including its friction."""
        push, open_rows = dict(self.on.J[i]), self._open.J
        for share, row in zip(rub, open_rows[i + 1 : i + 3], strict=True):
            for j, value in row.items():
                push[j] = push.get(j, ZERO) - share * value
        return push

    def masked(self, chosen: Sequence[int]) -> Rows:
        """Some rows in what is integrated, all zero where they are off."""
        rows = self._open.only(chosen)
        on = [1.0 - self._off[i] for i in chosen]
        J = [
            {j: scale * value for j, value in row.items()}
            for scale, row in zip(on, rows.J, strict=True)
        ]
        g = [scale * value for scale, value in zip(on, rows.g, strict=True)]
        return rows._replace(J=J, g=g)

    def slack_of(self, chosen: Sequence[int]) -> list[Any]:
        """The s of some rows."""
        return [self._off[i] for i in chosen]

    def of(self, *kinds: Reach) -> list[int]:
        """Rows of some kinds."""
        return [i for i, reach in enumerate(self._reach) if reach in kinds]

    def multipliers(self, lam: Sequence[Any]) -> list[Any]:
        """Return the multipliers of all rows, SX scalars, from those of active rows."""
        forces = []
        each = zip(self._mode_entries, self._off, self._lower, self._upper, lam, strict=True)
        for entry, off, lower, upper, solved in each:
            low, high = (ZERO if is_open(one) else one for one in (lower, upper))
            forces.append(
                (1.0 - off) * solved + 0.5 * entry * ((entry + 1.0) * low + (entry - 1.0) * high)
            )
        for i, rub in self._rubs.items():
            forces[i + 1 : i + 3] = (
                own - share * forces[i]
                for own, share in zip(forces[i + 1 : i + 3], rub, strict=True)
            )
        return forces

    def rates(self, v: Sequence[Any]) -> list[Any]:
        """The g' of rows that are on, SX scalars, 0 for others.

        Args:
            v: Velocity of all joints.
        """
        pairs = zip(self._off, self._rows.velocities(v), strict=True)
        return [(1.0 - off) * rate for off, rate in pairs]

    def heights(self, v: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """Heights of rows that are off, ends of slips, and rates of gaps."""
        margins, rates = self.spans(v), self._rows.velocities(v)
        for i, slip in self._slips.items():
            margins[i + 1 : i + 3] = slip.ends if self._mu[i] else (ONE, ONE)
        each = zip(self._mode_entries, rates, self._reach, strict=True)
        gap_rates = [entry * rate if reach is Reach.GAP else ZERO for entry, rate, reach in each]
        return margins, gap_rates

    def spans(self, v: Sequence[Any]) -> list[Any]:
        """How far rows that are off are from where they would be on."""
        distances, rates = [], self._rows.velocities(v)
        for i, (entry, off) in enumerate(zip(self._mode_entries, self._off, strict=True)):
            reach = self._reach[i]
            height = self._rows.g[i] if reach is Reach.GAP else rates[i]
            has_height = reach in (Reach.GAP, Reach.SLIP)
            distances.append(
                entry * height + (1.0 - off) * _ENDLESS if has_height else ca.SX(_ENDLESS)
            )
        for i, slip in self._slips.items():
            distances[i + 1] = slip.size
        return distances

    def names(self) -> Any:
        """0 where a slip should have another name, 2 where one follows its velocity, else 1."""
        keeps, follows = ONE, ZERO
        for slip in self._slips.values():
            keeps, follows = ca.fmin(keeps, slip.keeps_name), ca.fmax(follows, slip.turns)
        return keeps * (1.0 + follows)

    def answers(self, a: Sequence[Any], lam: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """Return margins of multipliers to their bounds, demands at a limit, and slip rates.

        Args:
            a: Accelerations of all joints, SX scalars.
            lam: Multipliers of these rows.
        """
        margins, rates, left = [], [], self.left(a)
        passed = PASSED * largest(lam) if self._slips else ZERO
        for i, (entry, off) in enumerate(zip(self._mode_entries, self._off, strict=True)):
            more = passed if i in self._slips or self._reach[i] is Reach.FRICTION else ZERO
            room = [(1.0 - off) * (one + more) + off * _ENDLESS for one in self._room(i, lam)]
            if self._reach[i] is Reach.DEMAND:
                room.append(entry * left[i] + (1.0 - off) * _ENDLESS)
            margins.extend(room)
            rates.append(entry * left[i] if self._reach[i] is Reach.SLIP else ZERO)
        return margins, rates

    @property
    def keys(self) -> dict[tuple[int, int], int]:
        """Where margins stand among those of `heights`, then those of `answers`."""
        numbers, n = dict[tuple[int, int], int](), len(self._mode_entries)
        for i, reach in enumerate(self._reach):
            if reach is not Reach.DEMAND:
                numbers[i, 0] = i
            if reach is Reach.FRICTION:
                mode = [1] if i - 1 in self._mu else []
            else:
                bounds = ((1, self._lower[i]), (-1, self._upper[i]))
                mode = [way for way, bound in bounds if not is_open(bound)]
            for way in [*mode, *[0] * (reach is Reach.DEMAND)]:
                numbers[i, way], n = n, n + 1
        return numbers

    def left(self, a: Sequence[Any]) -> list[Any]:
        """The w of all rows, by accelerations of all joints, SX scalars."""
        each = zip(self._rows.J, self._conditions, strict=True)
        return [
            sum((value * plain(a[j]) for j, value in row.items()), ZERO) + more
            for row, more in each
        ]

    def longest(self, a: Sequence[Any]) -> Any:
        """Length of a step in which slips that turn do not change by much [s]."""
        step, left = ca.SX(_LONG), self.left(a)
        for i, slip in self._slips.items():
            step = ca.fmin(step, slip.longest(left[i + 1 : i + 3]))
        return step

    def _room(self, i: int, every: Sequence[Any]) -> list[Any]:
        """Return the distances of a multiplier to its bounds."""
        if self._reach[i] is Reach.FRICTION:
            return [self._grip(i - 1, every)] if i - 1 in self._mu else []
        lam, lower, upper = every[i], self._lower[i], self._upper[i]
        ends = (None if is_open(lower) else lam - lower, None if is_open(upper) else upper - lam)
        return [one for one in ends if one is not None]


class Slip(NamedTuple):
    """A contact in a mode; SX scalars.

    Attributes:
        is_on: 1 where it slips, else 0.
        is_fine: 1 where the direction is that of the name.
        along: Velocity of its points along the plane.
        slowest: Slip that counts as none.
    """

    is_on: Any
    is_fine: Any
    name: tuple[Any, Any]
    along: tuple[Any, Any]
    size: Any
    slowest: Any

    @property
    def direction(self) -> tuple[Any, Any]:
        """Direction that friction opposes."""
        length, (x, y), (a, b) = self._length, self.along, self.name
        size = ca.if_else(self.size > 0.0, self.size, 1.0)
        turned = ca.if_else(x * a + y * b < 0.0, -size, size)
        pairs = ((a / length, x / turned), (b / length, y / turned))
        fine, other = (ca.if_else(self.is_fine, one, both) for one, both in pairs)
        return fine, other

    @property
    def ends(self) -> tuple[Any, Any]:
        """How far it is from where it ends, or is named anew; 1 where that does not count."""
        length, slow, (x, y), (a, b) = self._length, self.slowest, self.along, self.name
        along, across = (x * a + y * b) / length, (x * b - y * a) / length
        coarse = along - ca.if_else(self._is_grown, slip_directions.SLOW * slow, 0.0)
        straight = slow + slip_directions.STRAY * ca.fabs(along) - ca.fabs(across)
        fast = slip_directions.FAST * slip_directions.SLOW * slow - along
        fine = ca.if_else(length < slip_directions.STRAIGHT, fast, straight)
        first, second = (
            ca.if_else(self.is_fine, along, coarse),
            ca.if_else(self.is_fine, fine, 1.0),
        )
        return self._where(first), self._where(second)

    @property
    def keeps_name(self) -> Any:
        """0 where it should have another name, at the start of a step; else 1."""
        slow, (x, y), (a, b) = self.slowest, self.along, self.name
        is_fast = ca.logic_and(
            self.size > 2.0 * slip_directions.SLOW * slow, ca.logic_not(self._is_grown)
        )
        has_turned = x * a + y * b < slip_directions.TURNED * self.size * self._length
        turns = ca.logic_and(ca.logic_or(is_fast, has_turned), self.size > slow)
        return ca.logic_not(ca.logic_and(turns, self.turns))

    @property
    def turns(self) -> Any:
        """1 where it slips along its velocity, else 0."""
        return ca.logic_and(self.is_on, ca.logic_not(self.is_fine))

    @property
    def is_directed(self) -> Any:
        """0 where it is too slow to have a direction, else 1."""
        return ca.logic_not(ca.logic_and(self.turns, self.size <= self.slowest))

    def longest(self, rates: Sequence[Any]) -> Any:
        """Length of a step in which it does not change by much [s].

        Args:
            rates: Of its velocity.
        """
        rate = ca.sqrt(rates[0] * rates[0] + rates[1] * rates[1])
        return ca.if_else(self.turns, CHANGE * self.size / ca.fmax(rate, TINY), _LONG)

    @property
    def _length(self) -> Any:
        a, b = self.name
        square = a * a + b * b
        return ca.sqrt(ca.if_else(square > 0.0, square, 1.0))

    @property
    def _is_grown(self) -> Any:
        return ca.fabs(self.name[0]) > slip_directions.COARSE

    def _where(self, value: Any) -> Any:
        return ca.if_else(self.is_on, value, ONE)


def slip_of(normal: Any, name: tuple[Any, Any], along: tuple[Any, Any], speed: Any) -> Slip:
    """A contact in a mode.

    Args:
        way: Of its normal: 0 where it touches.
        name: Of its tangents.
        along: Velocity of its points along the plane.
        speed: The largest velocity of a joint.
    """
    a, b = name
    is_on = ca.logic_and(normal == 0.0, ca.logic_or(a != 0.0, b != 0.0))
    is_fine = ca.fmax(ca.fabs(a), ca.fabs(b)) > slip_directions.COARSE * slip_directions.GROWN
    size = ca.sqrt(along[0] * along[0] + along[1] * along[1])
    return Slip(is_on, is_fine, name, along, size, slip_directions.NO_SLIP * (1.0 + speed))
