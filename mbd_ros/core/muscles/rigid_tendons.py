"""Forces of many muscles beside rigid tendons at once, from tables: microseconds for a frame.

Curves are looked up instead of solved for: from knot to knot each is cut into cells with a
polynomial of degree 5 through Chebyshev points, which leaves some 1e-12 of the peak force. Where a
length or a speed is beyond its table, all muscles are asked directly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from mbd_ros.core.muscles.contraction import Contraction, Pennation
from mbd_ros.core.muscles.curves import ArrayNumbers
from mbd_ros.core.state import Array

_CELLS, _DEGREE = 512, 5  # of a table between two knots
_LENGTHS, _SPEEDS = (0.0, 2.5), (-2.0, 2.0)  # what tables cover, per optimal length and vmax


class RigidTendons:
    """Muscles side by side.

    Args:
        contractions: Of the muscles, at least one.
    """

    def __init__(self, contractions: Sequence[Contraction]) -> None:
        self._muscles = tuple(contractions)
        self._law = _stacked(contractions)
        known: dict[Any, list[_Table]] = {}
        for one in contractions:
            if one.curves.key not in known:
                known[one.curves.key] = _tables(one.curves)
        every = [known[one.curves.key] for one in contractions]
        self._tables = _Tables([tables[i] for i in range(3) for tables in every])

    def at(self, length: Array, speed: Array) -> RigidForces:
        """Forces of all muscles.

        Args:
            length: Of the paths [m], shape (.., n).
            speed: Their rates [m/s], same shape.
        """
        law, n = self._law, len(self._muscles)
        fiber = law.beside_rigid_tendon(ArrayNumbers, length, speed)
        relative, rate = fiber.length / law.optimal, fiber.velocity / law.fastest
        asked = np.concatenate((relative, rate, relative), axis=-1)
        if self._tables.hold(asked):
            found = self._tables(asked)
            factors = found[..., :n] * found[..., n : 2 * n], found[..., 2 * n :]
        else:
            factors = self._directly(relative, rate)
        along = law.peak * fiber.cosine
        active, passive = (along * factor for factor in factors)
        return RigidForces(active, passive, fiber.length, fiber.velocity)

    def _directly(self, relative: Array, rate: Array) -> tuple[Array, Array]:
        """Active and passive force per peak force, shape (.., n)."""
        active, passive = np.empty(relative.shape), np.empty(relative.shape)
        for i, one in enumerate(self._muscles):
            at = relative[..., i]
            active[..., i] = one.curves.fiber(ArrayNumbers, 1.0, at, rate[..., i])
            passive[..., i] = one.curves.passive(ArrayNumbers, at)
        return active, passive


def _stacked(contractions: Sequence[Contraction]) -> Contraction:
    """Sizes of all muscles as arrays, without their curves."""
    columns = zip(*(one[:4] for one in contractions), strict=True)
    pennations = zip(*(one.pennation for one in contractions), strict=True)
    peak, optimal, slack, fastest = (np.array(column) for column in columns)
    pennation = Pennation(*(np.array(column) for column in pennations))
    return Contraction(peak, optimal, slack, fastest, pennation, None)


class _Table(NamedTuple):
    """A curve in cells.

    Attributes:
        ends: Of its intervals, shape (m + 1,).
        rows: Polynomials of the share of a cell, highest power first, shape (m * cells, 6).
    """

    ends: Array
    rows: Array


def _tables(curves: Any) -> list[_Table]:
    """Active force-length, force-velocity at full activation, and passive force-length curve."""
    active, velocity, passive = curves.knots
    isometric = curves.active(ArrayNumbers, 1.0)

    def at_speed(speed: Array) -> Array:
        found: Array = curves.fiber(ArrayNumbers, 1.0, 1.0, speed) / isometric
        return found

    def of_length(curve: Callable[[Any, Any], Any]) -> Callable[[Array], Array]:
        return lambda length: curve(ArrayNumbers, length)

    return [
        _table(of_length(curves.active), active, _LENGTHS),
        _table(at_speed, velocity, _SPEEDS),
        _table(of_length(curves.passive), passive, _LENGTHS),
    ]


def _table(
    curve: Callable[[Array], Array], knots: Sequence[float], bounds: tuple[float, float]
) -> _Table:
    """A curve between bounds, smooth from knot to knot."""
    low, high = bounds
    ends = np.array([low, *(knot for knot in knots if low < knot < high), high])
    nodes = 0.5 * (chebyshev.chebpts1(_DEGREE + 1) + 1.0)
    begin = np.linspace(ends[:-1], ends[1:], _CELLS, endpoint=False).T.ravel()
    width = np.repeat(np.diff(ends) / _CELLS, _CELLS)
    values = curve((begin[:, None] + width[:, None] * nodes).ravel()).reshape(-1, _DEGREE + 1)
    to_powers = np.linalg.inv(np.vander(nodes))
    return _Table(ends, values.dot(to_powers.T))


class _Tables:
    """Curves side by side.

    Args:
        tables: One a curve.
    """

    def __init__(self, tables: Sequence[_Table]) -> None:
        most = max(len(table.ends) for table in tables) - 1
        shape = (len(tables), most)
        self._starts = np.full(shape, np.inf)
        self._pace = np.zeros(shape)
        self._cells = np.zeros(shape, dtype=np.intp)
        self._lower = np.array([table.ends[0] for table in tables])
        self._upper = np.array([table.ends[-1] for table in tables])
        rows: dict[int, int] = {}
        stack: list[Array] = []
        for i, table in enumerate(tables):
            if id(table) not in rows:
                rows[id(table)] = sum(map(len, stack))
                stack.append(table.rows)
            m = len(table.ends) - 1
            self._starts[i, :m] = table.ends[:-1]
            self._pace[i, :m] = _CELLS / np.diff(table.ends)
            self._cells[i, :m] = rows[id(table)] + _CELLS * np.arange(m)
        self._rows = np.concatenate(stack)
        self._first = most * np.arange(len(tables)) - 1

    def hold(self, at: Array) -> bool:
        """Whether all values are within the tables, shape (.., curves)."""
        return bool(((at >= self._lower) & (at <= self._upper)).all())

    def __call__(self, at: Array) -> Array:
        """Values of the curves, shape (.., curves)."""
        interval = self._first + (at[..., None] >= self._starts).sum(axis=-1)
        place = (at - self._starts.ravel()[interval]) * self._pace.ravel()[interval]
        cell = np.minimum(place.astype(np.intp), _CELLS - 1)
        share = place - cell
        rows = self._rows[self._cells.ravel()[interval] + cell]
        value = rows[..., 0]
        for power in range(1, _DEGREE + 1):
            value = value * share + rows[..., power]
        return value


class RigidForces(NamedTuple):
    """What muscles beside rigid tendons exert, shape (.., n) each.

    Attributes:
        active: Force along the tendon at full activation [N].
        passive: Elastic force of the fibres along the tendon [N].
        fiber_length: Of the fibres [m].
        fiber_velocity: Its rate [m/s].
    """

    active: Array
    passive: Array
    fiber_length: Array
    fiber_velocity: Array
