"""Where the unknowns of a trial of muscles stand in its program."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.program_block import Places


class MuscleNumbers(NamedTuple):
    """Numbers of unknowns: those of the start, then point by point in the order below.

    Attributes:
        degree: Points on an interval.
        a_start: Of activations at the start, shape (n,).
        fiber_start: Of lengths of fibres beside elastic tendons, shape (ne,).
        a: At the points, shape (points, n).
        e: Of excitations, same shape.
        r: Of efforts of reserves, shape (points, r).
        fiber: Of lengths of fibres, shape (points, ne).
        speed: Of speeds of fibres, same shape.
    """

    degree: int
    a_start: Places
    fiber_start: Places
    a: Places
    e: Places
    r: Places
    fiber: Places
    speed: Places

    @classmethod
    def of(cls, intervals: int, degree: int, n: int, r: int, ne: int) -> "MuscleNumbers":
        """Of a trial with so many intervals, muscles, reserves and elastic tendons."""
        each, first = 2 * n + r + 2 * ne, n + ne
        every = first + np.arange(intervals * degree * each).reshape(-1, each)
        parts = np.split(every, np.cumsum([n, n, r, ne]), axis=1)
        return cls(degree, np.arange(n), np.arange(n, first), *parts)

    def over_intervals(self, start: Places, points: Places, some: Sequence[int]) -> Places:
        """Of some states, those at the start of each interval above those at its points.

        Args:
            start: At the start.
            points: At the points.
            some: Which columns.

        Returns:
            Shape (1 + degree, intervals * len(some)).
        """
        ends = points[self.degree - 1 : -1 : self.degree]
        begins = np.concatenate((start[None], ends))[:, some]
        return np.concatenate((begins.reshape(1, -1), self.at_points(points, some)))

    def at_points(self, values: Array, some: Sequence[int]) -> Array:
        """Of some columns those at the points, shape (degree, intervals * len(some))."""
        found = values[:, some].reshape(-1, self.degree, len(some))
        return found.transpose(1, 0, 2).reshape(self.degree, -1)
