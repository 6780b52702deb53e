"""Points of a branch of periodic motions, and what changes between two of them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.gait.periodic import PeriodicMotion

DOUBLING, FOLD, TORUS = "period doubling", "fold", "torus bifurcation"


class BranchPoint(NamedTuple):
    """A periodic motion at one value of a parameter.

    Attributes:
        parameter: The value.
        motion: The motion.
        tangent: Direction of the branch: of the state before the event of the section, then of
            the parameter in units of its range; of length one, shape (n + 1,).
        slopes: Derivative of the residual by the same, shape (n, n + 1).
        mark: What happens there; empty for an ordinary point.
    """

    parameter: float
    motion: PeriodicMotion
    tangent: Array
    slopes: Array
    mark: str = ""


class Branch(NamedTuple):
    """Periodic motions along a parameter.

    Attributes:
        points: In the order of the branch.
        cycles: Cycles after which they repeat.
        ended: Why it ends.
    """

    points: tuple[BranchPoint, ...]
    cycles: int
    ended: str

    @property
    def marks(self) -> tuple[BranchPoint, ...]:
        """The points at which something happens."""
        return tuple(point for point in self.points if point.mark)


def changes(one: BranchPoint, other: BranchPoint) -> Iterator[str]:
    """What happens between two points of a branch: folds, doublings, tori."""
    for mark in (FOLD, DOUBLING, TORUS):
        if test(mark, one) * test(mark, other) < 0.0:
            yield mark


def test(mark: str, point: BranchPoint) -> float:
    """A number that changes its sign where something happens.

    Args:
        mark: A fold: the direction of the parameter. A doubling: prod (1 + m) of the multipliers
            m. A torus: |m|^2 - 1 of the pair of complex ones that is nearest to the unit circle.
        point: The point.

    Source: Y. Kuznetsov, Elements of Applied Bifurcation Theory, 2004, ch. 5 and 10.
    """
    found = point.motion.multipliers
    if mark == FOLD:
        return float(point.tangent[-1])
    if mark == DOUBLING:
        return float(np.prod(1.0 + found).real)
    pairs = np.abs(found[found.imag > 0.0]) ** 2 - 1.0
    return float(pairs[np.abs(pairs).argmin()]) if len(pairs) else 0.0
