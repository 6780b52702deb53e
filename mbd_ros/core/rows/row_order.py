"""Multipliers of all rows of a scene in one order, under every solver."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.parts import Constraint, Row
from mbd_ros.core.state import Array


class RowOrder:
    """Couplings first, then constraints as the scene lists them.

    The one place that knows which multipliers of a `Solution` belong to which solver.

    Args:
        parts: Couplings and constraints, in that order.

    Attributes:
        rows: One entry a multiplier.
        bilateral_rows: Those without bounds.
        bounded_rows: The others.
    """

    def __init__(self, parts: Sequence[Constraint] = ()) -> None:
        self.rows = numbered([row for part in parts for row in part.rows])
        is_bounded = [not part.law.is_rigid for part in parts for _ in part.rows]
        self._bounded = np.flatnonzero(np.array(is_bounded, dtype=np.bool_))
        self._bilateral = np.flatnonzero(~np.array(is_bounded, dtype=np.bool_))
        self.bilateral_rows = tuple(self.rows[i] for i in self._bilateral)
        self.bounded_rows = tuple(self.rows[i] for i in self._bounded)

    def bilateral(self, multipliers: Array) -> Array:
        """Those of the rows without bounds, in the order of `bilateral_rows`."""
        return multipliers[self._bilateral]

    def bounded(self, multipliers: Array) -> Array:
        """Those of the rows with bounds, in the order of `bounded_rows`."""
        return multipliers[self._bounded]

    def joined(self, bilateral: Array, bounded: Array) -> Array:
        """Multipliers of all rows, shape (len(rows),).

        Args:
            bilateral: Those of `bilateral_rows`.
            bounded: Those of `bounded_rows`.
        """
        multipliers = np.empty(len(self.rows))
        multipliers[self._bilateral], multipliers[self._bounded] = bilateral, bounded
        return multipliers


def numbered(rows: Sequence[Row]) -> tuple[Row, ...]:
    """The rows; equal names get a number: bar, bar#2, bar#3."""
    seen: Counter[str] = Counter()
    told_apart = []
    for row in rows:
        seen[row.name] += 1
        count = seen[row.name]
        told_apart.append(row if count == 1 else row._replace(name=f"{row.name}#{count}"))
    return tuple(told_apart)
