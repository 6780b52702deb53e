"""Rows that give way, in a mode that is an argument: one compiled function serves all modes.

The square of an entry m of a mode, 0 where a row is on and 1 or -1 at a bound, switches between
its equation and nothing, beside which its force at a bound is known:

    (1 - m^2) (J a + b) + m^2 lam = 0
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.motion import YieldingRows, is_open, largest
from mbd_ros.compiled.symbols.rows import Rows
from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.compiled.symbols.tree.link_rotations import ONE, ZERO
from mbd_ros.core.contact_modes.contact_modes import PASSED
from mbd_ros.core.contact_modes.row_distances import Reach

if TYPE_CHECKING:
    from mbd_ros.compiled.symbols.equations import Equations


from mbd_ros.core.contact_modes import slip_directions as names
from mbd_ros.core.contact_modes.contact_modes import CHANGE
from mbd_ros.core.thresholds import TINY

# Slips of contacts in a mode that is an argument; see `core.contact_modes.slip_directions`.
#
# The tangents of a contact that slips have two odd numbers along the slip in the mode, its name.

LONG = 1.0e9  # a step that no slip makes shorter [s]


class Slip(NamedTuple):
    """A contact in a mode; SX scalars.

    Attributes:
        is_on: 1 where it slips, else 0.
        is_fine: 1 where the direction is that of the name.
        name: Two numbers.
        along: Velocity of its points along the plane.
        size: Of that.
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
        """What friction is against."""
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
        coarse = along - ca.if_else(self._is_grown, names.SLOW * slow, 0.0)
        straight = slow + names.STRAY * ca.fabs(along) - ca.fabs(across)
        fast = names.FAST * names.SLOW * slow - along
        fine = ca.if_else(length < names.STRAIGHT, fast, straight)
        first, second = (
            ca.if_else(self.is_fine, along, coarse),
            ca.if_else(self.is_fine, fine, 1.0),
        )
        return self._where(first), self._where(second)

    @property
    def keeps_name(self) -> Any:
        """0 where it should have another name, at the start of a step; else 1."""
        slow, (x, y), (a, b) = self.slowest, self.along, self.name
        is_fast = ca.logic_and(self.size > 2.0 * names.SLOW * slow, ca.logic_not(self._is_grown))
        has_turned = x * a + y * b < names.TURNED * self.size * self._length
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
        return ca.if_else(self.turns, CHANGE * self.size / ca.fmax(rate, TINY), LONG)

    @property
    def _length(self) -> Any:
        a, b = self.name
        square = a * a + b * b
        return ca.sqrt(ca.if_else(square > 0.0, square, 1.0))

    @property
    def _is_grown(self) -> Any:
        return ca.fabs(self.name[0]) > names.COARSE

    def _where(self, value: Any) -> Any:
        return ca.if_else(self.is_on, value, ONE)


def slip_of(way: Any, name: tuple[Any, Any], along: tuple[Any, Any], speed: Any) -> Slip:
    """A contact in a mode.

    Args:
        way: Of its normal: 0 where it touches.
        name: Of its tangents.
        along: Velocity of its points along the plane.
        speed: The largest velocity of a joint.
    """
    a, b = name
    is_on = ca.logic_and(way == 0.0, ca.logic_or(a != 0.0, b != 0.0))
    is_fine = ca.fmax(ca.fabs(a), ca.fabs(b)) > names.COARSE * names.GROWN
    size = ca.sqrt(along[0] * along[0] + along[1] * along[1])
    return Slip(is_on, is_fine, name, along, size, names.NO_SLIP * (1.0 + speed))


_PASSED = 1.0  # a margin that never ends


class Looks(NamedTuple):
    """What is looked at after a step; SX scalars, one a row.

    Attributes:
        margins: Positive while the mode goes on.
        rates: Rates of the margins of rows that are off, 0 where they have no height.
    """

    margins: list[Any]
    rates: list[Any]


class SwitchedRows(YieldingRows):
    """Rows that give way at events, in every mode.

    Args:
        equations: Of the system.
        ways: The mode, one SX scalar a row.

    Raises:
        Untraceable: Names what has no symbolic form.
    """

    def __init__(self, equations: "Equations", ways: Sequence[Any]) -> None:
        self._ask(equations)
        self._ways = ways
        self._slips = self._slipping(equations.velocity)
        tangents = {i + j for i in self._slips for j in (1, 2)}
        self._off = [way != 0.0 if i in tangents else way * way for i, way in enumerate(ways)]
        self.slack, self.touching = self._off, list(self._slips)
        self._open = self._whole.reduced(self._c)
        self.on = self.masked(range(len(ways)))
        self.bias = [(1.0 - off) * self._biased(i) for i, off in enumerate(self._off)]
        self._rubs = {i: self._rub(i, slip) for i, slip in self._slips.items()}
        self.pushing = {i: self._pushed(i, rub) for i, rub in self._rubs.items()}
        for slip in self._slips.values():
            self.directed = ca.fmin(self.directed, slip.is_directed)

    def _slipping(self, v: Sequence[Any]) -> dict[int, Slip]:
        """Contacts by the rows of their normals."""
        rates, speed = self._whole.velocities(v), largest(v) if self._mu else ZERO
        found = {}
        for i in self._mu:
            name, along = self._ways[i + 1 : i + 3], rates[i + 1 : i + 3]
            found[i] = slip_of(self._ways[i], (name[0], name[1]), (along[0], along[1]), speed)
        return found

    def _rub(self, i: int, slip: Slip) -> tuple[Any, Any]:
        """Friction against a slip, of the force of its normal."""
        x, y = slip.direction
        return self._mu[i] * slip.is_on * x, self._mu[i] * slip.is_on * y

    def _pushed(self, i: int, rub: tuple[Any, Any]) -> dict[int, Any]:
        """What the normal of a contact pushes along, its friction included."""
        push, own = dict(self.on.J[i]), self._open.J
        for share, row in zip(rub, own[i + 1 : i + 3], strict=True):
            for j, value in row.items():
                push[j] = push.get(j, ZERO) - share * value
        return push

    def masked(self, chosen: Sequence[int]) -> Rows:
        """Some rows in what is integrated, all zero where they are off."""
        rows = self._open.only(chosen)
        on = [1.0 - self._off[i] for i in chosen]
        J = [
            {j: one * value for j, value in row.items()}
            for one, row in zip(on, rows.J, strict=True)
        ]
        g = [one * value for one, value in zip(on, rows.g, strict=True)]
        return rows._replace(J=J, g=g)

    def slack_of(self, chosen: Sequence[int]) -> list[Any]:
        """The s of some rows."""
        return [self._off[i] for i in chosen]

    def of(self, *kinds: Reach) -> list[int]:
        """Rows of some kinds."""
        return [i for i, one in enumerate(self._reach) if one in kinds]

    def multipliers(self, lam: Sequence[Any]) -> list[Any]:
        """Of all rows, SX scalars, from the multipliers of those that are on."""
        found = []
        each = zip(self._ways, self._off, self._lower, self._upper, lam, strict=True)
        for way, off, lower, upper, solved in each:
            low, high = (ZERO if is_open(one) else one for one in (lower, upper))
            found.append(
                (1.0 - off) * solved + 0.5 * way * ((way + 1.0) * low + (way - 1.0) * high)
            )
        for i, rub in self._rubs.items():
            found[i + 1 : i + 3] = (
                own - share * found[i]
                for own, share in zip(found[i + 1 : i + 3], rub, strict=True)
            )
        return found

    def rates(self, v: Sequence[Any]) -> list[Any]:
        """The g' of rows that are on, SX scalars, 0 for others.

        Args:
            v: Velocity of all joints.
        """
        pairs = zip(self._off, self._whole.velocities(v), strict=True)
        return [(1.0 - off) * rate for off, rate in pairs]

    def heights(self, v: Sequence[Any]) -> Looks:
        """Heights of rows that are off, ends of slips, and rates of gaps."""
        margins, rates = self.spans(v), self._whole.velocities(v)
        for i, slip in self._slips.items():
            margins[i + 1 : i + 3] = slip.ends if self._mu[i] else (ONE, ONE)
        each = zip(self._ways, rates, self._reach, strict=True)
        found = [way * rate if reach is Reach.GAP else ZERO for way, rate, reach in each]
        return Looks(margins, found)

    def spans(self, v: Sequence[Any]) -> list[Any]:
        """How far rows that are off are from where they would be on."""
        found, rates = [], self._whole.velocities(v)
        for i, (way, off) in enumerate(zip(self._ways, self._off, strict=True)):
            reach = self._reach[i]
            height = self._whole.g[i] if reach is Reach.GAP else rates[i]
            has_height = reach in (Reach.GAP, Reach.SLIP)
            found.append(way * height + (1.0 - off) * _PASSED if has_height else ca.SX(_PASSED))
        for i, slip in self._slips.items():
            found[i + 1] = slip.size
        return found

    def names(self) -> Any:
        """0 where a slip should have another name, 2 where one follows its velocity, else 1."""
        kept, turns = ONE, ZERO
        for slip in self._slips.values():
            kept, turns = ca.fmin(kept, slip.keeps_name), ca.fmax(turns, slip.turns)
        return kept * (1.0 + turns)

    def answers(self, a: Sequence[Any], lam: Sequence[Any]) -> Looks:
        """What multipliers are within their bounds, demands at a limit, and rates of slips.

        Args:
            a: Accelerations of all joints, SX scalars.
            lam: Multipliers of these rows.
        """
        margins, rates, left = [], [], self.left(a)
        passed = PASSED * largest(lam) if self._slips else ZERO
        for i, (way, off) in enumerate(zip(self._ways, self._off, strict=True)):
            more = passed if i in self._slips or self._reach[i] is Reach.FRICTION else ZERO
            room = [(1.0 - off) * (one + more) + off * _PASSED for one in self._room(i, lam)]
            if self._reach[i] is Reach.DEMAND:
                room.append(way * left[i] + (1.0 - off) * _PASSED)
            margins.extend(room)
            rates.append(way * left[i] if self._reach[i] is Reach.SLIP else ZERO)
        return Looks(margins, rates)

    @property
    def keys(self) -> dict[tuple[int, int], int]:
        """Where margins stand among those of `heights`, then those of `answers`."""
        found, n = dict[tuple[int, int], int](), len(self._ways)
        for i, reach in enumerate(self._reach):
            if reach is not Reach.DEMAND:
                found[i, 0] = i
            if reach is Reach.FRICTION:
                ways = [1] if i - 1 in self._mu else []
            else:
                bounds = ((1, self._lower[i]), (-1, self._upper[i]))
                ways = [way for way, bound in bounds if not is_open(bound)]
            for way in [*ways, *[0] * (reach is Reach.DEMAND)]:
                found[i, way], n = n, n + 1
        return found

    def left(self, a: Sequence[Any]) -> list[Any]:
        """The w of all rows, by accelerations of all joints, SX scalars."""
        each = zip(self._whole.J, self._conditions, strict=True)
        return [
            sum((value * plain(a[j]) for j, value in row.items()), ZERO) + more
            for row, more in each
        ]

    def longest(self, a: Sequence[Any]) -> Any:
        """Length of a step in which slips that turn do not change by much [s]."""
        found, left = ca.SX(LONG), self.left(a)
        for i, slip in self._slips.items():
            found = ca.fmin(found, slip.longest(left[i + 1 : i + 3]))
        return found

    def _room(self, i: int, every: Sequence[Any]) -> list[Any]:
        """What is left of a multiplier to its bounds."""
        if self._reach[i] is Reach.FRICTION:
            return [self._grip(i - 1, every)] if i - 1 in self._mu else []
        lam, lower, upper = every[i], self._lower[i], self._upper[i]
        ends = (None if is_open(lower) else lam - lower, None if is_open(upper) else upper - lam)
        return [one for one in ends if one is not None]
