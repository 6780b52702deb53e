"""Intervals of a phase, and the next mesh.

Intervals whose error is too large are split by the order of their method. Where bounds begin and
cease to be active, inputs jump or bend. A polynomial cannot follow a jump within an interval, and
its error does not show, since the motion is exact for the inputs that it has. So a node is put
near every change, and moves with the motion to where it costs least.
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
_UNKNOWN = 2  # no status: differs from all others
_MOST = 24  # changes in a phase: more of them are no structure
_SHORTEST = 1.0e-7  # of a phase: jumps are not resolved any further
_WIDEST = 0.7  # of an interval that is to be split: the widest part that is left of it
_AT_NODE = 0.02  # of an interval: a change so near to a node is at it
_MOST_PARTS = 4  # of one interval at once: an estimate far from its limit says no more
_SAFE = 0.5  # of the tolerance: what a refined interval aims at


class Mesh(NamedTuple):
    """Intervals of a phase.

    Attributes:
        scheme: Name of the collocation.
        degrees: Of each interval, shape (n,).
        widths: Their shares of the duration, adding up to 1, shape (n,).
        free: Whether the end of an interval may move, the last one never, shape (n,).
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
        found = np.concatenate(([0.0], np.cumsum(self.widths)))
        found[-1] = 1.0
        return found

    @property
    def first_points(self) -> Numbers:
        """Number of the first point of each interval, then of all, shape (n + 1,)."""
        return np.concatenate(([0], np.cumsum(self.degrees))).astype(np.intp)

    @property
    def shares(self) -> Array:
        """Where the points are, as shares of the duration, shape (points,)."""
        starts, parts = self.knots, zip(self.degrees, self.widths, strict=True)
        return np.concatenate(
            [starts[i] + w * self.scheme_of(int(d)).c for i, (d, w) in enumerate(parts)]
        )

    def scheme_of(self, degree: int) -> Collocation:
        """The collocation of a degree."""
        return collocation(self.scheme, degree)

    def find(self, shares: Array) -> tuple[Numbers, Array]:
        """Interval of shares of the duration, and where in it they are, 0 .. 1."""
        knots = self.knots
        i = np.clip(np.searchsorted(knots, shares, side="right") - 1, 0, self.intervals - 1)
        return i, (shares - knots[i]) / np.maximum(self.widths[i], np.finfo(float).tiny)


def build_mesh(
    scheme: str, degrees: Sequence[int], widths: Array, free: Sequence[bool] | None = None
) -> Mesh:
    """A mesh of some intervals."""
    moves = np.zeros(len(degrees), dtype=np.bool_) if free is None else np.array(free, dtype=bool)
    whole = np.asarray(widths, dtype=np.float64)
    return Mesh(scheme, np.array(degrees, dtype=np.intp), whole / whole.sum(), moves)


def refine_mesh(mesh: Mesh, errors: Array, tolerance: float) -> Mesh:
    """Intervals whose error is too large are split, by the order of their method.

    Args:
        errors: Relative error of each interval, shape (n,).
        tolerance: What is accepted.
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
    """The mesh with a node that may move at each of some places."""
    knots, degrees, moving = mesh.knots.tolist(), mesh.degrees.tolist(), set[float]()
    for share in shares:
        i = int(np.clip(np.searchsorted(knots, share, side="right") - 1, 0, len(degrees) - 1))
        near = min((knots[i], knots[i + 1]), key=lambda one: abs(one - share))
        if abs(near - share) > _AT_NODE * (knots[i + 1] - knots[i]):
            knots.insert(i + 1, share)
            degrees.insert(i + 1, degrees[i])
            near = share
        if 0.0 < near < 1.0:
            moving.add(near)
    free = np.array([knot in moving for knot in knots[1:]], dtype=np.bool_)
    return Mesh(mesh.scheme, np.array(degrees, dtype=np.intp), np.diff(knots), free)


def is_settled(mesh: Mesh, shares: list[float]) -> bool:
    """Whether every change is at a node that may move."""
    moving = mesh.knots[1:][mesh.free]
    return all(np.abs(moving - share).min(initial=np.inf) < 1.0e-9 for share in shares)


class Collocation:
    """Collocation of one degree on an interval: points, and integrals of polynomials.

        x(s) = x0 + h sum_k A_k(s) x'_k,   A_k(s) = integral of l_k from 0 to s

    l_k are the polynomials of Lagrange of the points c_k in 0 .. 1. Source: E. Hairer, G. Wanner,
    Solving Ordinary Differential Equations II, 1996, sec. IV.5.

    Args:
        scheme: One of `SCHEMES`; Hermite and Simpson's is the one of Lobatto with three points.
        degree: Number of points.

    Attributes:
        c: The points, shape (degree,).
        A: A_k(c_j), shape (degree, degree).
        b: A_k(1), shape (degree,).

    Raises:
        ModelError: A degree that the scheme does not have.
    """

    def __init__(self, scheme: str, degree: int) -> None:
        least, most = (3, 3) if scheme == HERMITE_SIMPSON else (1, LARGEST_DEGREE + 1)
        if not least <= degree <= most:
            raise ModelError(
                f"degree {degree} of {scheme}, accepted: {least} .. {most - (most > 3)}"
            )
        self.scheme, self.degree = scheme, degree
        self.c = _points(scheme, degree)
        self._to_series = np.linalg.inv(legendre.legvander(2.0 * self.c - 1.0, degree - 1))
        self._to_integrals: Array = legendre.legint(self._to_series, lbnd=-1, scl=0.5, axis=0)
        self.A = self.integrals(self.c)
        self.b = self.integrals(np.ones(1))[0]

    @property
    def joins_inputs(self) -> bool:
        """Whether both ends are points, so that neighbours share their inputs there."""
        return self.scheme == HERMITE_SIMPSON

    @property
    def finer(self) -> Collocation:
        """Gauss's points, one more than this one has."""
        return collocation(GAUSS, self.degree + 1)

    def values(self, s: Array) -> Array:
        """l_k at some places, shape (n, degree).

        Args:
            s: Places in 0 .. 1, shape (n,).
        """
        series = legendre.legvander(2.0 * np.asarray(s, dtype=np.float64) - 1.0, self.degree - 1)
        found: Array = series @ self._to_series
        return found

    def integrals(self, s: Array) -> Array:
        """A_k at some places, shape (n, degree).

        Args:
            s: Places in 0 .. 1, shape (n,).
        """
        series = legendre.legvander(2.0 * np.asarray(s, dtype=np.float64) - 1.0, self.degree)
        found: Array = series @ self._to_integrals
        found[np.abs(found) < _DENSE] = 0.0
        return found

    def powers(self) -> Array:
        """Coefficients of the l_k by rising power of s, shape (degree, degree); do not write."""
        return self._powers

    @cached_property
    def _powers(self) -> Array:
        columns = [
            np.polynomial.Legendre(one, domain=[0.0, 1.0]).convert(kind=np.polynomial.Polynomial)
            for one in self._to_series.T
        ]
        found = np.zeros((self.degree, self.degree))
        for k, one in enumerate(columns):
            found[: len(one.coef), k] = one.coef
        return found


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
    """The scheme of a degree, made once."""
    return Collocation(scheme, degree)


def uniform_mesh(scheme: str, degree: int, count: int) -> Mesh:
    """Equal intervals of one degree."""
    return build_mesh(scheme, [degree] * count, np.full(count, 1.0 / count))


def input_changes(mesh: Mesh, status: Status, inputs: Array) -> list[float]:
    """Where bounds of inputs change, as shares of the duration, in order.

    Args:
        status: At every point, inputs first, shape (m, k).
        inputs: Values at every point, shape (m, nu).

    Returns:
        Nothing where there are more than a structure has.
    """
    shares, found = mesh.shares, set[float]()
    interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
    for k in range(inputs.shape[1]):
        for i in np.flatnonzero(np.diff(status[:, k])):
            one, other = int(interval[i]), int(interval[i + 1])
            if one != other:
                found.add(float(mesh.knots[other]))
            elif status[i, k] * status[i + 1, k] < 0:
                found.add(_jump(mesh, one, inputs[:, k]))
            else:
                found.add(float(0.5 * (shares[i] + shares[i + 1])))
    return sorted(found) if len(found) <= _MOST else []


def _jump(mesh: Mesh, interval: int, values: Array) -> float:
    """Where an input would jump between the values that it has at the ends of an interval."""
    own = slice(*mesh.first_points[interval : interval + 2])
    some = values[own]
    mean = float(mesh.scheme_of(int(mesh.degrees[interval])).b @ some)
    inside = np.clip((mean - some[-1]) / (some[0] - some[-1]), 0.0, 1.0)
    return float(mesh.knots[interval] + mesh.widths[interval] * inside)


def bracket_changes(mesh: Mesh, status: Status, begins: Status, wanted: NDArray[np.bool_]) -> Mesh:
    """The mesh with nodes on both sides of where bounds of states change.

    A node that moves to where it costs least would move to where the motion passes its bound
    between two points; these intervals shrink instead.

    Args:
        status: Of states at every point, shape (m, k).
        begins: Of states at the first node of every interval, shape (n, j), j <= k.
        wanted: Which intervals are to be split, and for which bounds, shape (n, k).
    """
    interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
    owner = np.insert(interval, mesh.first_points[:-1], np.arange(mesh.intervals))
    shares = np.insert(mesh.shares, mesh.first_points[:-1], mesh.knots[:-1])
    every = np.insert(status, mesh.first_points[:-1], _at_begins(mesh, status, begins), axis=0)
    knots = list(zip(mesh.knots[:-1].tolist(), mesh.degrees.tolist(), strict=True))
    ends = np.diff(every, axis=0).astype(np.bool_) & (wanted[owner[:-1]] | wanted[owner[1:]])
    for i in np.flatnonzero(ends.any(axis=1)):
        knots += [(float(shares[k]), int(mesh.degrees[owner[k]])) for k in (i, i + 1)]
    for i in np.flatnonzero(wanted.any(axis=1)):
        inner = [one for one, _ in knots if mesh.knots[i] <= one <= mesh.knots[i + 1]]
        if np.diff(sorted([*inner, mesh.knots[i + 1]])).max() > _WIDEST * mesh.widths[i]:
            middle = 0.5 * (mesh.knots[i] + mesh.knots[i + 1])
            knots.append((float(middle), int(mesh.degrees[i])))
    kept = [one for one in sorted(set(knots)) if one[0] <= 1.0 - _SHORTEST]
    kept = kept[:1] + [two for one, two in itertools.pairwise(kept) if two[0] - one[0] > _SHORTEST]
    places = np.array([*(one for one, _ in kept), 1.0])
    return build_mesh(mesh.scheme, [degree for _, degree in kept], np.diff(places))


def _at_begins(mesh: Mesh, status: Status, begins: Status) -> Status:
    """Status at the first nodes; columns that are unknown there change if neighbours differ."""
    first = mesh.first_points[:-1]
    after, before = status[first], status[np.maximum(first - 1, 0)]
    found = np.where(after == before, after, _UNKNOWN)
    found[0] = after[0]
    found[:, : begins.shape[1]] = begins
    return found
