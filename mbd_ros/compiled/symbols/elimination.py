"""The order in which a sparse matrix loses its rows, so that few entries fill in."""

from collections.abc import Iterable, Mapping

Edges = Iterable[tuple[int, int]]


def order_of(
    edges: Edges, size: int, after: Mapping[int, Iterable[int]] | None = None
) -> list[int]:
    """Rows by least degree, ties by number, the highest first.

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
        row = min(free, key=lambda one: (len(beside[one]), -one))
        order.append(row)
        left.discard(row)
        for other in beside[row]:
            beside[other] |= beside[row]
            beside[other] -= {row, other}
        for rows in waits.values():
            rows.discard(row)
    return order
