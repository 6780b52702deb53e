"""Forces of many muscles with rigid tendons at once, from tables, within microseconds.

Between its knots, each curve is tabulated by polynomials of degree 5 through Chebyshev points,
with an error of some 1e-12 of the peak force. If a length or speed is outside of its table, all
muscles are evaluated directly.
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
    """Tabulated forces of muscles with rigid tendons.

    Args:
        contractions: Contraction dynamics of the muscles, at least one.
    """

    def __init__(self, contractions: Sequence[Contraction]) -> None:
        self._muscles = tuple(contractions)
        self._stacked_contraction = _stacked(contractions)
        known: dict[Any, list[_Table]] = {}
        for muscle in contractions:
            if muscle.curves.key not in known:
                known[muscle.curves.key] = _tables(muscle.curves)
        every = [known[muscle.curves.key] for muscle in contractions]
        self._tables = _Tables([tables[i] for i in range(3) for tables in every])

    def at(self, length: Array, speed: Array) -> RigidForces:
        """Return the forces of all muscles.

        Args:
            length: Lengths of the paths [m], shape (.., n).
            speed: Rates of the lengths [m/s], shape (.., n).
        """
        muscles, n = self._stacked_contraction, len(self._muscles)
        fiber = muscles.beside_rigid_tendon(ArrayNumbers, length, speed)
        relative, rate = fiber.length / muscles.optimal, fiber.velocity / muscles.fastest
        arguments = np.concatenate((relative, rate, relative), axis=-1)
        if self._tables.hold(arguments):
            values = self._tables(arguments)
            factors = values[..., :n] * values[..., n : 2 * n], values[..., 2 * n :]
        else:
            factors = self._directly(relative, rate)
        along = muscles.peak * fiber.cosine
        active, passive = (along * factor for factor in factors)
        return RigidForces(active, passive, fiber.length, fiber.velocity)

    def _directly(self, relative: Array, rate: Array) -> tuple[Array, Array]:
        """Return active and passive force per peak force, shape (.., n)."""
        active, passive = np.empty(relative.shape), np.empty(relative.shape)
        for i, muscle in enumerate(self._muscles):
            length = relative[..., i]
            active[..., i] = muscle.curves.fiber(ArrayNumbers, 1.0, length, rate[..., i])
            passive[..., i] = muscle.curves.passive(ArrayNumbers, length)
        return active, passive


def _stacked(contractions: Sequence[Contraction]) -> Contraction:
    """Return the parameters of all muscles as arrays, without their curves."""
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
        """Return the values of the curves, shape (.., curves)."""
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
    """Forces of muscles with rigid tendons, shape (.., n) each.

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
