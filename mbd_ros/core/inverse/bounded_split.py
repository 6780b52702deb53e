"""Efforts and multipliers within bounds and cones, where the smallest ones are beyond them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.inverse.force_split import ForceSplit, Split
from mbd_ros.core.optimization.least_in_bounds import Least, least_in_bounds
from mbd_ros.core.state import Array

_FREE = -np.inf, np.inf
_KEPT = 1.0e-9  # of the largest force, by which a cone may be passed
_PASSED = 1.0e-7  # the same, where nothing better is found
_SAME = 0.999  # cosine of the angle between planes that nearly are one
_CUTS = 25  # planes that touch a cone; an angle between two of them is squared each time


class Limits(NamedTuple):
    """What forces y may be: between bounds, and in cones |y_t| <= mu y_n.

    Attributes:
        lower: Lower ends, shape (n,).
        upper: Upper ends, shape (n,).
        cones: Where a normal and its two tangents stand in y, shape (k, 3).
        mu: Coefficient of friction of each, shape (k,).
    """

    lower: Array
    upper: Array
    cones: NDArray[np.intp]
    mu: Array

    def keeps(self, y: Array) -> bool:
        """Whether forces are within."""
        slack = _KEPT * (1.0 + float(np.abs(y).max(initial=0.0))) if len(self.mu) else 0.0
        inside = (y >= self.lower - slack).all() and (y <= self.upper + slack).all()
        return bool(inside and (self._beyond(y)[0] <= slack).all())

    def cuts(self, y: Array) -> Array:
        """Planes through the cones that y is beyond: rows c with c . y >= 0, shape (c, n)."""
        beyond, direction = self._beyond(y)
        chosen = np.flatnonzero(beyond > 0.0)
        rows = np.zeros((len(chosen), len(y)))
        for row, i in zip(rows, chosen, strict=True):
            row[self.cones[i, 0]], row[self.cones[i, 1:]] = self.mu[i], -direction[i]
        return rows

    def passed(self, y: Array, margin: float) -> NDArray[np.bool_]:
        """Which forces are beyond their limits by more than a share of the largest, shape (n,)."""
        least = margin * np.abs(y).max(initial=0.0)
        beyond: NDArray[np.bool_] = np.maximum(self.lower - y, y - self.upper) > least
        beyond[self.cones[self._beyond(y)[0] > least].ravel()] = True
        return beyond

    def _beyond(self, y: Array) -> tuple[Array, Array]:
        """|y_t| - mu y_n of each cone, shape (k,), and y_t / |y_t|, shape (k, 2)."""
        tangents = y[self.cones[:, 1:]]
        length = np.hypot(tangents[:, 0], tangents[:, 1])
        unit = tangents / np.where(length > 0.0, length, 1.0)[:, None]
        return length - self.mu * y[self.cones[:, 0]], unit


class Wish(NamedTuple):
    """Numbers S y that come as near to a target as they can, before anything is small.

    Attributes:
        S: Shape (k, n).
        target: Shape (k,).
    """

    S: Array
    target: Array


class Within(NamedTuple):
    """Forces that are as small as bounds let them be.

    Attributes:
        split: Efforts and multipliers.
        residual: Forces of free bases, shape (k,).
        is_within: Whether the bounds are kept; otherwise they cannot be, and the excess is the
            least.
    """

    split: Split
    residual: Array
    is_within: bool


def within_bounds(
    split: ForceSplit,
    b: Array,
    found: Split,
    bases: tuple[Array, Array],
    limits: Limits,
    wish: Wish | None = None,
) -> Within:
    """Keep bounds: with the least residual of free bases, then efforts, then multipliers.

    Args:
        split: Factors of the equation.
        b: The force that is split, shape (nv,).
        found: The answer without bounds.
        bases: Columns R of free bases, shape (nv, k), and the residual without bounds, (k,).
        limits: Of efforts, then multipliers.
        wish: What comes right after the residual.
    """
    (R, r), ne = bases, len(found.efforts)
    y = np.concatenate((found.efforts, found.multipliers))
    if wish is None and limits.keeps(y):
        return Within(found, r, True)
    groups = slice(0, ne), slice(ne, None)
    least = _least(y, _directions(split), groups, limits, wish)
    if not least.is_within and len(r):
        least, r = _with_bases(split, y, bases, limits, ne, wish)
    return Within(split.left(b - R.dot(r), least.z[:ne], least.z[ne:]), r, least.is_within)


def _with_bases(
    split: ForceSplit,
    y: Array,
    bases: tuple[Array, Array],
    limits: Limits,
    ne: int,
    wish: Wish | None,
) -> tuple[Least, Array]:
    """The same where free bases take what the bounds leave."""
    R, r = bases
    k = len(r)
    wide, T = split.beside(R)
    groups = slice(0, k), slice(k, k + ne), slice(k + ne, None)
    lower, upper = (
        np.concatenate((np.full(k, end), ends))
        for end, ends in zip(_FREE, limits[:2], strict=True)
    )
    if wish is not None:
        wish = Wish(np.concatenate((np.zeros((len(wish.S), k)), wish.S), axis=1), wish.target)
    wider = Limits(lower, upper, limits.cones + k, limits.mu)
    least = _least(np.concatenate((T.dot(r), y)), _directions(wide), groups, wider, wish, k)
    residual: Any = np.linalg.solve(T, least.z[:k])
    return least._replace(z=least.z[k:]), residual


def _least(
    z: Array,
    N: Array,
    groups: Sequence[slice],
    limits: Limits,
    wish: Wish | None = None,
    first: int = 0,
) -> Least:
    """Least norms within bounds and cones; planes are laid against these until they are kept.

    A wish comes after the first groups: those of the first entries.
    """
    n, S, target = len(z), np.zeros((0, len(z))), np.zeros(0)
    if wish is not None:
        S, target = wish
    before = 1 if first else 0
    wished = [slice(n, n + len(S))] if len(S) else []
    order = [*groups[:before], *wished, *groups[before:]]
    cuts, margin = np.zeros((0, n)), _PASSED if len(limits.mu) else 0.0
    best = Least(z, False)
    for _ in range(_CUTS):
        cuts = _with_new(cuts, limits.cuts(best.z))
        more = np.concatenate((S, cuts))
        values = np.concatenate((z, S.dot(z) - target, cuts.dot(z)))
        free, planes = np.full(len(S), np.inf), len(cuts)
        lower = np.concatenate((limits.lower, -free, np.zeros(planes)))
        upper = np.concatenate((limits.upper, free, np.full(planes, np.inf)))
        directions = np.concatenate((N, more.dot(N)))
        found = least_in_bounds(values, directions, order, lower, upper, margin)
        best = Least(found.z[:n], found.is_within)
        if not (found.is_within and len(limits.mu)) or limits.keeps(best.z):
            return best
    return best


def _with_new(cuts: Array, new: Array) -> Array:
    """All planes, without those that new ones nearly repeat: two of these fix the edge badly."""
    sizes = np.linalg.norm(cuts, axis=1)[:, None] * np.linalg.norm(new, axis=1)
    repeated = (cuts.dot(new.T) > _SAME * sizes).any(axis=1)
    kept: Array = np.concatenate((cuts[~repeated], new))
    return kept


def _directions(split: ForceSplit) -> Array:
    """Orthonormal directions of what exerts nothing."""
    return np.asarray(np.linalg.qr(split.null_basis())[0], dtype=np.float64)
