"""Efforts and multipliers within bounds and cones, where the smallest ones are beyond them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.inverse_dynamics.force_split import ForceSplit, Split
from mbd_ros.core.optimization.cone_limits import Limits
from mbd_ros.core.optimization.least_norm_in_bounds import Least, least_in_bounds
from mbd_ros.core.optimization.least_norm_in_cones import least_in_cones
from mbd_ros.core.state import Array

_FREE = -np.inf, np.inf
_KEPT = 1.0e-9  # of the largest force, by which limits of contacts may be passed
_WEIGHTS = 1.0, 1.0e-3, 1.0e-6, 1.0e-8  # of what comes first, and then


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
    slack = _KEPT * (1.0 + float(np.abs(y).max(initial=0.0))) if len(limits.mu) else 0.0
    if wish is None and (limits.excess(y) <= slack).all():
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
    """Least norms within limits; a wish comes after the first group, if that is of bases."""
    if wish is None and not len(limits.mu):
        return least_in_bounds(z, N, groups, limits.lower, limits.upper)
    every, nothing = np.eye(len(z)), np.zeros(len(z))
    rows = [(every[group], nothing[group]) for group in groups]
    if wish is not None:
        rows.insert(1 if first else 0, wish)
    weighted = zip(_WEIGHTS, rows, strict=False)
    A, c = zip(*((weight * A, weight * c) for weight, (A, c) in weighted), strict=True)
    return Least(*least_in_cones(z, N, np.concatenate(A), np.concatenate(c), limits))


def _directions(split: ForceSplit) -> Array:
    """Orthonormal directions of what exerts nothing."""
    return np.asarray(np.linalg.qr(split.null_basis())[0], dtype=np.float64)
