"""Intervals of a phase, and the numbers of what is unknown on them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.collocation import Collocation, collocation

Numbers = NDArray[np.intp]


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


def uniform_mesh(scheme: str, degree: int, count: int) -> Mesh:
    """Equal intervals of one degree."""
    return mesh_of(scheme, [degree] * count, np.full(count, 1.0 / count))


def mesh_of(
    scheme: str, degrees: Sequence[int], widths: Array, free: Sequence[bool] | None = None
) -> Mesh:
    """A mesh of some intervals."""
    moves = np.zeros(len(degrees), dtype=np.bool_) if free is None else np.array(free, dtype=bool)
    whole = np.asarray(widths, dtype=np.float64)
    return Mesh(scheme, np.array(degrees, dtype=np.intp), whole / whole.sum(), moves)
