"""Intervals of a phase, and the next mesh.

Intervals whose error is too large are split according to the order of their method. Where bounds
become active or inactive, inputs jump or bend. A polynomial cannot follow a jump within an
interval, and the error estimate does not show this, since the motion is exact for its inputs. So a
node is put near every change, and the program moves it to the place of least cost.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

GAUSS, RADAU, HERMITE_SIMPSON = "gauss", "radau", "hermite_simpson"
SCHEMES = (GAUSS, RADAU, HERMITE_SIMPSON)
LARGEST_DEGREE = 16
MOST_INTERVALS = 100_000
_DENSE = 1.0e-12  # of a coefficient: rounding
Numbers = NDArray[np.intp]
Status = NDArray[np.int_]  # -1 at a lower bound, 1 at an upper one, else 0
_UNKNOWN = 2  # different from every status
_MOST = 24  # changes in a phase: with more of them, no nodes are inserted
_SHORTEST = 1.0e-7  # of a phase: jumps are not resolved any further
_WIDEST = 0.7  # of an interval that is to be split: largest width of its parts
_AT_NODE = 0.02  # of an interval: a change so near to a node is at the node
_MOST_PARTS = 4  # of one interval in one refinement, since large error estimates are inaccurate
_SAFE = 0.5  # of the tolerance: target of a refined interval


class Mesh(NamedTuple):
    """Intervals of a phase.

    Attributes:
        scheme: Name of the collocation.
        degrees: Number of points of each interval, shape (n,).
        widths: Their shares of the duration, adding up to 1, shape (n,).
        free: Whether the end of an interval may move, which the last one never may, shape (n,).
    """

    scheme: str
    degrees: Numbers
    widths: Array
    free: NDArray[np.bool_]

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return len(self.degrees)

    @property
    def knots(self) -> Array:
        """Ends of intervals as shares of the duration, shape (n + 1,)."""
        knots = np.concatenate(([0.0], np.cumsum(self.widths)))
        knots[-1] = 1.0
        return knots

    @property
    def first_points(self) -> Numbers:
        """Index of the first point of each interval, then the number of points, shape (n + 1,)."""
        return np.concatenate(([0], np.cumsum(self.degrees))).astype(np.intp)

    @property
    def shares(self) -> Array:
        """Points as shares of the duration, shape (points,)."""
        starts, parts = self.knots, zip(self.degrees, self.widths, strict=True)
        return np.concatenate(
            [starts[i] + w * self.scheme_of(int(d)).c for i, (d, w) in enumerate(parts)]
        )

    def scheme_of(self, degree: int) -> Collocation:
        """Return the collocation of a degree."""
        return collocation(self.scheme, degree)

    def find(self, shares: Array) -> tuple[Numbers, Array]:
        """Return the intervals of shares of the duration, and the places in them, 0 .. 1."""
        knots = self.knots
        i = np.clip(np.searchsorted(knots, shares, side="right") - 1, 0, self.intervals - 1)
        return i, (shares - knots[i]) / np.maximum(self.widths[i], np.finfo(float).tiny)


def build_mesh(
    scheme: str, degrees: Sequence[int], widths: Array, free: Sequence[bool] | None = None
) -> Mesh:
    """Build a mesh from degrees and widths."""
    moves = np.zeros(len(degrees), dtype=np.bool_) if free is None else np.array(free, dtype=bool)
    shares = np.asarray(widths, dtype=np.float64)
    return Mesh(scheme, np.array(degrees, dtype=np.intp), shares / shares.sum(), moves)


def refine_mesh(mesh: Mesh, errors: Array, tolerance: float) -> Mesh:
    """Split the intervals whose error is too large, according to the order of their method.

    Args:
        errors: Relative error of each interval, shape (n,).
        tolerance: Accepted error.
    """
    degrees, widths = list[int](), list[float]()
    for degree, width, error in zip(mesh.degrees, mesh.widths, errors, strict=True):
        parts = 1
        if error > tolerance and width > _SHORTEST:
            wanted = (error / (_SAFE * tolerance)) ** (1.0 / (degree + 1))
            parts = min(max(2, math.ceil(wanted)), _MOST_PARTS)
        degrees += [int(degree)] * parts
        widths += [width / parts] * parts
    return build_mesh(mesh.scheme, degrees, np.array(widths))


def insert_nodes(mesh: Mesh, shares: list[float]) -> Mesh:
    """Return the mesh with a node that may move at each of the given shares."""
    knots, degrees, moving = mesh.knots.tolist(), mesh.degrees.tolist(), set[float]()
    for share in shares:
        i = int(np.clip(np.searchsorted(knots, share, side="right") - 1, 0, len(degrees) - 1))
        near = min((knots[i], knots[i + 1]), key=lambda knot: abs(knot - share))
        if abs(near - share) > _AT_NODE * (knots[i + 1] - knots[i]):
            knots.insert(i + 1, share)
            degrees.insert(i + 1, degrees[i])
            near = share
        if 0.0 < near < 1.0:
            moving.add(near)
    free = np.array([knot in moving for knot in knots[1:]], dtype=np.bool_)
    return Mesh(mesh.scheme, np.array(degrees, dtype=np.intp), np.diff(knots), free)


def is_settled(mesh: Mesh, shares: list[float]) -> bool:
    """Return whether every change is at a node that may move."""
    moving = mesh.knots[1:][mesh.free]
    return all(np.abs(moving - share).min(initial=np.inf) < 1.0e-9 for share in shares)


class Collocation:
    """Collocation of one degree on an interval: points and integrals of polynomials.

        x(s) = x0 + h sum_k A_k(s) x'_k,   A_k(s) = integral of l_k from 0 to s

    l_k are the Lagrange polynomials of the points c_k in 0 .. 1. Source: E. Hairer, G. Wanner,
    Solving Ordinary Differential Equations II, 1996, sec. IV.5.

    Args:
        scheme: One of `SCHEMES`; that of Hermite and Simpson is Lobatto's with three points.
        degree: Number of points.

    Attributes:
        c: The points, shape (degree,).
        A: A_k(c_j), shape (degree, degree).
        b: A_k(1), shape (degree,).

    Raises:
        ModelError: The scheme does not have this degree.
    """

    def __init__(self, scheme: str, degree: int) -> None:
        least, most = (3, 3) if scheme == HERMITE_SIMPSON else (1, LARGEST_DEGREE + 1)
        if not least <= degree <= most:
            raise ModelError(
                f"degree {degree} of {scheme} is out of range, accepted: {least} .. "
                f"{most - (most > 3)}"
            )
        self.scheme = scheme
        self.degree = degree
        self.c = _points(scheme, degree)
        self._to_series = np.linalg.inv(legendre.legvander(2.0 * self.c - 1.0, degree - 1))
        self._to_integrals: Array = legendre.legint(self._to_series, lbnd=-1, scl=0.5, axis=0)
        self.A = self.integrals(self.c)
        self.b = self.integrals(np.ones(1))[0]

    @property
    def joins_inputs(self) -> bool:
        """Whether both ends are points, so that neighbouring intervals share inputs there."""
        return self.scheme == HERMITE_SIMPSON

    @property
    def finer(self) -> Collocation:
        """Gauss collocation with one more point."""
        return collocation(GAUSS, self.degree + 1)

    def values(self, s: Array) -> Array:
        """Return l_k at some places, shape (n, degree).

        Args:
            s: Places in 0 .. 1, shape (n,).
        """
        series = legendre.legvander(2.0 * np.asarray(s, dtype=np.float64) - 1.0, self.degree - 1)
        values: Array = series @ self._to_series
        return values

    def integrals(self, s: Array) -> Array:
        """Return A_k at some places, shape (n, degree).

        Args:
            s: Places in 0 .. 1, shape (n,).
        """
        series = legendre.legvander(2.0 * np.asarray(s, dtype=np.float64) - 1.0, self.degree)
        integrals: Array = series @ self._to_integrals
        integrals[np.abs(integrals) < _DENSE] = 0.0
        return integrals

    def powers(self) -> Array:
        """Return the coefficients of l_k by rising powers of s, shape (degree, degree)."""
        return self._powers

    @cached_property
    def _powers(self) -> Array:
        columns = [
            np.polynomial.Legendre(l_k, domain=[0.0, 1.0]).convert(kind=np.polynomial.Polynomial)
            for l_k in self._to_series.T
        ]
        coefficients = np.zeros((self.degree, self.degree))
        for k, column in enumerate(columns):
            coefficients[: len(column.coef), k] = column.coef
        return coefficients


def _points(scheme: str, degree: int) -> Array:
    if scheme == HERMITE_SIMPSON:
        return np.array([0.0, 0.5, 1.0])
    if scheme == GAUSS:
        return np.sort(0.5 * (legendre.leggauss(degree)[0] + 1.0))
    series = np.zeros(degree + 1)
    series[degree], series[degree - 1] = 1.0, -1.0  # P_d - P_(d - 1): its last zero is the end
    inner = np.sort(legendre.legroots(series).real)[:-1]
    return np.append(0.5 * (inner + 1.0), 1.0)


@cache
def collocation(scheme: str, degree: int) -> Collocation:
    """Return the collocation of a degree, which is built once."""
    return Collocation(scheme, degree)


def uniform_mesh(scheme: str, degree: int, count: int) -> Mesh:
    """Return a mesh of equal intervals of one degree."""
    return build_mesh(scheme, [degree] * count, np.full(count, 1.0 / count))


def input_changes(mesh: Mesh, status: Status, inputs: Array) -> list[float]:
    """Return where active bounds of inputs change, as shares of the duration, in order.

    Args:
        status: Status at every point, inputs first, shape (m, k).
        inputs: Values of inputs at every point, shape (m, nu).

    Returns:
        An empty list if there are too many changes.
    """
    shares, places = mesh.shares, set[float]()
    interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
    for k in range(inputs.shape[1]):
        for i in np.flatnonzero(np.diff(status[:, k])):
            before, after = int(interval[i]), int(interval[i + 1])
            if before != after:
                places.add(float(mesh.knots[after]))
            elif status[i, k] * status[i + 1, k] < 0:
                places.add(_jump(mesh, before, inputs[:, k]))
            else:
                places.add(float(0.5 * (shares[i] + shares[i + 1])))
    return sorted(places) if len(places) <= _MOST else []


def _jump(mesh: Mesh, interval: int, values: Array) -> float:
    """Return where an input would jump between its values at the ends of an interval."""
    points = slice(*mesh.first_points[interval : interval + 2])
    u = values[points]
    mean = float(mesh.scheme_of(int(mesh.degrees[interval])).b @ u)
    inside = np.clip((mean - u[-1]) / (u[0] - u[-1]), 0.0, 1.0)
    return float(mesh.knots[interval] + mesh.widths[interval] * inside)


def bracket_changes(mesh: Mesh, status: Status, begins: Status, wanted: NDArray[np.bool_]) -> Mesh:
    """Return the mesh with nodes on both sides of changes of active bounds of states.

    A node that may move would move to where the motion violates its bound between two points;
    these intervals shrink instead.

    Args:
        status: Status of states at every point, shape (m, k).
        begins: Status of states at the first node of every interval, shape (n, j), j <= k.
        wanted: Which intervals to split for which bounds, shape (n, k).
    """
    interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
    owner = np.insert(interval, mesh.first_points[:-1], np.arange(mesh.intervals))
    shares = np.insert(mesh.shares, mesh.first_points[:-1], mesh.knots[:-1])
    first_status = _at_begins(mesh, status, begins)
    all_status = np.insert(status, mesh.first_points[:-1], first_status, axis=0)
    knots = list(zip(mesh.knots[:-1].tolist(), mesh.degrees.tolist(), strict=True))
    changes = np.diff(all_status, axis=0).astype(np.bool_)
    ends = changes & (wanted[owner[:-1]] | wanted[owner[1:]])
    for i in np.flatnonzero(ends.any(axis=1)):
        knots += [(float(shares[k]), int(mesh.degrees[owner[k]])) for k in (i, i + 1)]
    for i in np.flatnonzero(wanted.any(axis=1)):
        inner = [knot for knot, _ in knots if mesh.knots[i] <= knot <= mesh.knots[i + 1]]
        if np.diff(sorted([*inner, mesh.knots[i + 1]])).max() > _WIDEST * mesh.widths[i]:
            middle = 0.5 * (mesh.knots[i] + mesh.knots[i + 1])
            knots.append((float(middle), int(mesh.degrees[i])))
    intervals = [pair for pair in sorted(set(knots)) if pair[0] <= 1.0 - _SHORTEST]
    later = [b for a, b in itertools.pairwise(intervals) if b[0] - a[0] > _SHORTEST]
    intervals = intervals[:1] + later
    places = np.array([*(knot for knot, _ in intervals), 1.0])
    return build_mesh(mesh.scheme, [degree for _, degree in intervals], np.diff(places))


def _at_begins(mesh: Mesh, status: Status, begins: Status) -> Status:
    """Return the status at first nodes; unknown columns count as changed if neighbours differ."""
    first = mesh.first_points[:-1]
    after, before = status[first], status[np.maximum(first - 1, 0)]
    first_status = np.where(after == before, after, _UNKNOWN)
    first_status[0] = after[0]
    first_status[:, : begins.shape[1]] = begins
    return first_status
