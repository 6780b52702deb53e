"""Impulses of least norm among those that do the same.

    min |p|^2   subject to   A p = A p_0,   p within its bounds and cones

The slips are those of p_0, so that friction of a contact that slips goes with its normal. Where
the shortest p of all that do the same is beyond a bound or a cone, Newton's method solves the dual
problem: p is then the projection onto bounds and cones of a vector that A p sees. Source: H. Qi,
D. Sun, SIAM J. Matrix Anal. Appl. 28 (2006) 360, on nearest points by Newton's method.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mbd_ros.core.complementarity.cone_newton import Bounds, ConeNewton, Seen, shortest
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant

_NONE = 1.0e-11  # of the impulses: a rate that is none
_BEYOND = 1.0e-12  # of the impulses: how far beyond a cone counts as within
_SAME = 1.0e-13  # of the impulses: what may be left of A p = A p_0
_STEPS = 40
_HALVINGS = 20
_ENOUGH = 1.0e-4  # of the decrease that a step promises


def least_impulses(newton: ConeNewton, seen: Seen, bounds: Bounds, p: Array, unit: Array) -> Array:
    """The impulses of least norm that do what p does; p itself where they are not found.

    Args:
        seen: The natural map of the problem at p.
        bounds: What impulses may be.
        p: An answer, shape (m,).
        unit: Of the impulses, shape (m,): the norm is that of unit p.
    """
    shares = _shares(newton, seen, bounds, p, unit)
    columns, given = _columns(shares, len(p)), unit * p
    count, does = columns.shape[1], newton.A.dot(columns / unit[:, None])
    if not count:
        return p
    sought = columns.T.dot(given)
    shares_of_all, rank = shortest(does, does.dot(sought))
    if rank == count:
        return p
    size = float(np.abs(given).max())
    target = given + columns.dot(shares_of_all - sought)
    within = _nearest(shares, given, target)
    if np.abs(within - target).max() > _BEYOND * size:
        basis = np.linalg.qr(columns.dot(_null(does)))[0]
        found = _projected(shares, basis, given / size, target / size)
        if found is None:
            return p
        within = size * found
    return within / unit


def _shares(newton: ConeNewton, seen: Seen, bounds: Bounds, p: Array, unit: Array) -> _Shares:
    contacts, none = newton.contacts, _NONE * (1.0 + float(np.abs(p).max()))
    w, units = seen.w.tolist(), unit.tolist()
    rows = [
        (i, units[i] * low, units[i] * high)
        for i, low, high in zip(
            contacts.others.tolist(), bounds.lower.tolist(), bounds.upper.tolist(), strict=True
        )
        if abs(w[i]) <= none
    ]
    sticks, slides = list[tuple[int, float, float]](), list[tuple[int, float, Array]]()
    normal, mus, leasts = (each.tolist() for each in (contacts.normal, contacts.mu, bounds.least))
    for c, (i, mu, least) in enumerate(zip(normal, mus, leasts, strict=True)):
        if abs(w[i]) > none:
            continue
        least, mu = units[i] * least, mu * units[i + 1] / units[i]
        slip = math.hypot(w[i + 1], w[i + 2])
        if slip <= none and mu > 0.0:
            sticks.append((i, least, mu))
            continue
        x, y = float(seen.x[c]), float(seen.y[c])
        if not seen.slips[c]:
            x, y = -w[i + 1] / max(slip, none), -w[i + 2] / max(slip, none)
        length = math.hypot(1.0, mu)
        slides.append((i, least, np.array((1.0 / length, mu * x / length, mu * y / length))))
    return _Shares(rows, sticks, slides)


class _Shares(NamedTuple):
    """Which impulses may change, in units of the norm.

    Attributes:
        rows: Rows between bounds that hold, with their bounds.
        sticks: Contacts that stick: the normal, its least impulse, the coefficient of friction.
        slides: Those that slip: the same, with a direction of length one.
    """

    rows: list[tuple[int, float, float]]
    sticks: list[tuple[int, float, float]]
    slides: list[tuple[int, float, Array]]


def _columns(shares: _Shares, m: int) -> Array:
    """Impulses that may change, one a column, shape (m, k)."""
    own = [i for i, *_ in shares.rows] + [i + j for i, *_ in shares.sticks for j in range(3)]
    columns = np.zeros((m, len(own) + len(shares.slides)))
    columns[own, range(len(own))] = 1.0
    for column, (i, _, along) in enumerate(shares.slides, start=len(own)):
        columns[i : i + 3, column] = along
    return columns


def _nearest(shares: _Shares, given: Array, y: Array) -> Array:
    """The point of all bounds and cones that is nearest to y; impulses that stay are given."""
    p = given.copy()
    for i, low, high in shares.rows:
        p[i] = min(max(float(y[i]), low), high)
    for i, least, mu in shares.sticks:
        p[i : i + 3] = nearest_in_cone(y[i : i + 3], mu, least)[0]
    for i, least, along in shares.slides:
        p[i : i + 3] = max(float(along.dot(y[i : i + 3])), least / float(along[0])) * along
    return p


def nearest_in_cone(y: Array, mu: float, least: float = 0.0) -> tuple[Array, Array]:
    """The nearest p with p_n >= least, |p_t| <= mu p_n, and its derivative by y.

    Args:
        y: A normal and two tangents, shape (3,).
        mu: Coefficient of friction, > 0.
        least: Smallest normal, >= 0.
    """
    n, length = float(y[0]), math.hypot(y[1], y[2])
    share, is_inside = 1.0 / (1.0 + mu * mu), length <= mu * n
    normal = n if is_inside else max((n + mu * length) * share, 0.0)
    if is_inside and normal >= least:
        return y.copy(), np.eye(3)
    slope = np.zeros((3, 3))
    if normal == least == 0.0:
        return np.zeros(3), slope
    d = y[1:] / length if length > 0.0 else np.zeros(2)
    across = np.array((-d[1], d[0]))
    if normal >= least:
        edge = np.array((1.0, *(mu * d)))
        slope = share * np.outer(edge, edge)
        slope[1:, 1:] += mu * normal / length * np.outer(across, across)
        return normal * edge, slope
    most = mu * least
    if length <= most:
        slope[1:, 1:] = np.eye(2)
        return np.array((least, *y[1:])), slope
    slope[1:, 1:] = most / length * np.outer(across, across)
    return np.array((least, *(most * d))), slope


def _null(B: Array) -> Array:
    """What B makes nothing of, one a column."""
    _, values, right = np.linalg.svd(B)
    rank = int((values > redundant(len(B)) * values.max(initial=0.0)).sum())
    null: Array = right[rank:].T
    return null


def _projected(shares: _Shares, basis: Array, given: Array, y: Array) -> Array | None:
    """The shortest impulses within bounds and cones that do the same; None where not found.

    Args:
        shares: Which impulses may change.
        basis: Changes that do nothing, orthonormal, shape (m, k).
        given: Impulses, of the order of 1.
        y: Where to begin.
    """
    seen = np.eye(len(y)) - basis.dot(basis.T)

    def height(y: Array, p: Array) -> float:
        return float(0.5 * (y.dot(y) - (y - p).dot(y - p)) - y.dot(given))

    p = _nearest(shares, given, y)
    for _ in range(_STEPS):
        left = seen.dot(p - given)
        if np.abs(left).max() <= _SAME:
            return p
        step = -shortest(seen.dot(_slope(shares, y)).dot(seen), left)[0]
        before, falls, share = height(y, p), float(left.dot(step)), 1.0
        for _ in range(_HALVINGS):
            after = y + share * step
            p = _nearest(shares, given, after)
            if height(after, p) <= before + _ENOUGH * share * falls:
                break
            share *= 0.5
        y = after
    return None


def _slope(shares: _Shares, y: Array) -> Array:
    """The derivative of `_nearest` by y, shape (m, m)."""
    D = np.zeros((len(y), len(y)))
    for i, low, high in shares.rows:
        D[i, i] = 1.0 if low < y[i] < high else 0.0
    for i, least, mu in shares.sticks:
        D[i : i + 3, i : i + 3] = nearest_in_cone(y[i : i + 3], mu, least)[1]
    for i, least, along in shares.slides:
        if along[0] * along.dot(y[i : i + 3]) > least:
            D[i : i + 3, i : i + 3] = np.outer(along, along)
    return D
