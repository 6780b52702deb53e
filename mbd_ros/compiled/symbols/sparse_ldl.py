"""Sparse L D L' of symbolic matrices, unrolled: zeros cost nothing, the order is given."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols.untraceable import Untraceable

Entries = Mapping[tuple[int, int], Any]  # of the lower triangle, (i, j) with i >= j


class SparseLdl:
    """Factors of a symmetric matrix whose pivots do not vanish in an order.

    Args:
        entries: The lower triangle, SX scalars; what is absent is zero.
        order: Rows in the order of their elimination.

    Attributes:
        pivots: Diagonal of D by row.

    Raises:
        Untraceable: A pivot vanishes in every state.
    """

    def __init__(self, entries: Entries, order: Iterable[int]) -> None:
        self._order = list(order)
        rows: dict[int, dict[int, Any]] = {i: {} for i in self._order}
        for (i, j), value in entries.items():
            if not value.is_zero():
                rows[i][j] = rows[j][i] = value
        self.pivots: dict[int, Any] = {}
        self._shares: dict[int, Any] = {}
        self._columns: dict[int, list[tuple[int, Any]]] = {}
        left = set(self._order)
        for k in self._order:
            left.discard(k)
            if k not in rows[k]:
                raise Untraceable("masses or rows are singular in every state")
            pivot = self.pivots[k] = rows[k][k]
            share = self._shares[k] = 1.0 / pivot
            touched = sorted(i for i in rows[k] if i in left)
            column = [(i, share * rows[k][i]) for i in touched]
            self._columns[k] = column
            for at, (i, factor) in enumerate(column):
                for j in touched[at:]:
                    value = rows[i].get(j, _ZERO) - factor * rows[k][j]
                    rows[i][j] = rows[j][i] = value

    @property
    def size(self) -> int:
        """Operations of a solution, about."""
        return 4 * sum(map(len, self._columns.values())) + len(self._order)

    def solve(self, right: Sequence[Any]) -> list[Any]:
        """The solution for one right side, an SX scalar a row."""
        x = list(right)
        for k in self._order:
            if not x[k].is_zero():
                for i, factor in self._columns[k]:
                    x[i] = x[i] - factor * x[k]
        for k in reversed(self._order):
            x[k] = self._shares[k] * x[k]
            for i, factor in self._columns[k]:
                x[k] = x[k] - factor * x[i]
        return x


def solved(entries: Entries, right: Sequence[Any], order: Iterable[int]) -> list[Any]:
    """The solution for one right side."""
    return SparseLdl(entries, order).solve(right)


_ZERO = ca.SX(0.0)
