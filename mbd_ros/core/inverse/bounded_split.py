"""Efforts and multipliers within bounds, where the smallest ones are beyond them."""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.inverse.force_split import ForceSplit, Split
from mbd_ros.core.optimization.least_in_bounds import Least, least_in_bounds
from mbd_ros.core.state import Array

_FREE = -np.inf, np.inf


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
    bounds: tuple[Array, Array],
) -> Within:
    """Keep bounds: with the least residual of free bases, then efforts, then multipliers.

    Args:
        split: Factors of the equation.
        b: The force that is split, shape (nv,).
        found: The answer without bounds.
        bases: Columns R of free bases, shape (nv, k), and the residual without bounds, (k,).
        bounds: Lower and upper ends of efforts, then multipliers, each (ne + m,).
    """
    (R, r), (lower, upper), ne = bases, bounds, len(found.efforts)
    y = np.concatenate((found.efforts, found.multipliers))
    if ((y >= lower) & (y <= upper)).all():
        return Within(found, r, True)
    groups = slice(0, ne), slice(ne, None)
    least = least_in_bounds(y, _directions(split), groups, lower, upper)
    if not least.is_within and len(r):
        least, r = _with_bases(split, y, bases, bounds, ne)
    return Within(split.left(b - R.dot(r), least.z[:ne], least.z[ne:]), r, least.is_within)


def _with_bases(
    split: ForceSplit,
    y: Array,
    bases: tuple[Array, Array],
    bounds: tuple[Array, Array],
    ne: int,
) -> tuple[Least, Array]:
    """The same where free bases take what the bounds leave."""
    R, r = bases
    k = len(r)
    wide, T = split.beside(R)
    groups = slice(0, k), slice(k, k + ne), slice(k + ne, None)
    ends = (np.concatenate((np.full(k, end), b)) for end, b in zip(_FREE, bounds, strict=True))
    z = np.concatenate((T.dot(r), y))
    least = least_in_bounds(z, _directions(wide), groups, *ends)
    residual: Any = np.linalg.solve(T, least.z[:k])
    return least._replace(z=least.z[k:]), residual


def _directions(split: ForceSplit) -> Array:
    """Orthonormal directions of what exerts nothing."""
    return np.asarray(np.linalg.qr(split.null_basis())[0], dtype=np.float64)
