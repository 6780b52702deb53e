"""Sparse L D L' of symbolic matrices, unrolled: zeros cost nothing.

CasADi's `ldl` takes symmetric matrices only, divides by a pivot once more, and its order puts
multipliers of rows, whose diagonal is zero, before the masses that they need.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols.untraceable import Untraceable

Entries = Mapping[tuple[int, int], Any]  # of the lower triangle, (i, j) with i >= j
_ZERO = ca.SX(0.0)


class SparseLdl:
    """Factors of a matrix whose pivots do not vanish in an order, symmetric but for some entries.

    Args:
        entries: The lower triangle, SX scalars; what is absent is zero.
        order: Rows in the order of their elimination.
        upper: Entries (j, i) of the upper triangle that differ, as (i, j) with i > j.

    Attributes:
        pivots: Diagonal of D by row.

    Raises:
        Untraceable: A pivot vanishes in every state.
    """

    def __init__(
        self, entries: Entries, order: Iterable[int], upper: Entries | None = None
    ) -> None:
        self._order = list(order)
        rows = self._rows = _square(entries, upper or {}, self._order)
        self.pivots: dict[int, Any] = {}
        self._shares: dict[int, Any] = {}
        self._columns: dict[int, list[tuple[int, Any]]] = {}
        self._beside: dict[int, list[tuple[int, Any]]] = {}
        left = set(self._order)
        for k in self._order:
            left.discard(k)
            if k not in rows[k]:
                raise Untraceable("masses or rows are singular in every state")
            pivot = self.pivots[k] = rows[k][k]
            share = self._shares[k] = 1.0 / pivot
            touched = sorted(i for i in rows[k] if i in left)
            self._columns[k] = [(i, share * rows[i][k]) for i in touched]
            self._beside[k] = [
                (i, lower if rows[i][k] is rows[k][i] else share * rows[k][i])
                for i, lower in self._columns[k]
            ]
            self._eliminate(k)

    def _eliminate(self, k: int) -> None:
        """Take a row from those that it touches."""
        rows, column = self._rows, self._columns[k]
        for at, (i, factor) in enumerate(column):
            for j, other in column[at:]:
                lower, across = rows[i].get(j, _ZERO), rows[j].get(i, _ZERO)
                is_same = lower is across or i == j
                is_same = is_same and rows[i][k] is rows[k][i] and rows[j][k] is rows[k][j]
                rows[i][j] = value = lower - factor * rows[k][j]
                if i != j:
                    rows[j][i] = value if is_same else across - other * rows[k][i]

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
            for i, factor in self._beside[k]:
                x[k] = x[k] - factor * x[i]
        return x


def _square(entries: Entries, upper: Entries, order: Sequence[int]) -> dict[int, dict[int, Any]]:
    """Both triangles by rows; the same object stands in both where they do not differ."""
    rows: dict[int, dict[int, Any]] = {i: {} for i in order}
    for (i, j), value in entries.items():
        if not value.is_zero():
            rows[i][j] = rows[j][i] = value
    for (i, j), value in upper.items():
        rows[j][i] = value
        rows[i].setdefault(j, _ZERO)
    return rows


def elimination_order(
    edges: Iterable[tuple[int, int]], size: int, after: Mapping[int, Iterable[int]] | None = None
) -> list[int]:
    """The order in which a sparse matrix loses its rows, so that few entries fill in.

    It is the order of least degree, ties by number, the highest first.

    Args:
        edges: Entries beside the diagonal that are not zero.
        size: Number of rows.
        after: Row -> rows that must have gone before, as the pivot of a multiplier needs the
            masses of all that its row moves.

    Source: A. George, J. W. H. Liu, The evolution of the minimum degree ordering algorithm, SIAM
    Review 31, 1989.
    """
    beside: list[set[int]] = [set() for _ in range(size)]
    for i, j in edges:
        if i != j:
            beside[i].add(j)
            beside[j].add(i)
    waits = {row: set(rows) for row, rows in (after or {}).items()}
    left, order = set(range(size)), list[int]()
    while left:
        free = [row for row in left if not waits.get(row)]
        row = min(free, key=lambda node: (len(beside[node]), -node))
        order.append(row)
        left.discard(row)
        for other in beside[row]:
            beside[other] |= beside[row]
            beside[other] -= {row, other}
        for rows in waits.values():
            rows.discard(row)
    return order
