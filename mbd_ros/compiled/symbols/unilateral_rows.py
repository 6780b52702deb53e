"""Rows that give way, in a mode: those that are on are equations, the others known forces."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca

from mbd_ros.compiled.symbols.link_rotations import ZERO
from mbd_ros.compiled.symbols.motion import NO_PUSHES
from mbd_ros.compiled.symbols.rows import Rows, rows_of
from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.multiplier_laws import Kind
from mbd_ros.core.state import Mode

if TYPE_CHECKING:
    from mbd_ros.compiled.symbols.equations import Equations

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
