"""Runs that are worth their time: front, and cost at a wanted error."""

import math
from collections.abc import Sequence
from typing import NamedTuple


class Point(NamedTuple):
    """Cost [any unit, > 0] and error [any unit, > 0] of a run."""

    cost: float
    error: float


def front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other one beats in both, from cheap to precise.

    Args:
        points: Any order; those that are not finite and positive are never on the front.
    """
    usable = [i for i, p in enumerate(points) if all(math.isfinite(x) and x > 0 for x in p)]
    best: list[int] = []
    for i in sorted(usable, key=lambda i: points[i]):
        if not best or points[i].error < points[best[-1]].error:
            best.append(i)
    return best


def cost_at(points: Sequence[Point], error: float) -> float | None:
    """Cost of an error on the front, between two runs by a power law.

    Args:
        points: Any runs.
        error: Wanted error.

    Returns:
        None where no run is as precise; the cost of the cheapest run where that is more precise
        than wanted, since nothing is known of cheaper ones.
    """
    best = [points[i] for i in front(points)]
    for k, (cost, reached) in enumerate(best):
        if reached <= error:
            if k == 0:
                return cost
            before = best[k - 1]
            share = math.log(before.error / error) / math.log(before.error / reached)
            return before.cost * (cost / before.cost) ** share
    return None


def cheapest(points: Sequence[Point], error: float) -> int | None:
    """Index of the cheapest run that is as precise as wanted; None where none is."""
    good = [i for i in front(points) if points[i].error <= error]
    return min(good, key=lambda i: points[i].cost, default=None)
