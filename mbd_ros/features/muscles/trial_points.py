"""Where a trial of muscles is looked at, and what is between."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.collocation import Collocation

_NEAR = 1.0  # longest intervals beside one that is cut: muscles forget over some 0.02 s
_HALVED = 4  # times, at either end: activations change fastest there


class Points(NamedTuple):
    """Where a trial is looked at.

    Attributes:
        knots: Ends of the intervals [s], shape (intervals + 1,).
        scheme: The collocation on each.
    """

    knots: Array
    scheme: Collocation

    @property
    def times(self) -> Array:
        """Of the points [s]."""
        h = np.diff(self.knots)[:, None]
        found: Array = (self.knots[:-1, None] + h * self.scheme.c).ravel()
        return found

    @property
    def whole(self) -> Array:
        """The start, then the times of the points [s]."""
        return np.concatenate(([0.0], self.times))

    def states(self, values: Array, t: Array) -> Array:
        """What is continuous, at some times: polynomials through the points and the end before.

        Args:
            values: At the start and at the points.
            t: The times [s].
        """
        stacked = self._stacked(values)
        starts = np.concatenate((values[:1], stacked[:-1, -1]))[:, None]
        interval, s = self._find(t)
        whole = np.concatenate((starts, stacked), axis=1)[interval]
        powers, ends = np.arange(self.scheme.degree + 1), np.concatenate(([0.0], self.scheme.c))
        weights = s[:, None] ** powers @ np.linalg.inv(ends[:, None] ** powers)
        return np.einsum("tk,tki->ti", weights, whole)

    def inputs(self, values: Array, t: Array) -> Array:
        """What jumps from interval to interval, at some times; arguments as `states`."""
        interval, s = self._find(t)
        return np.einsum("tk,tki->ti", self.scheme.values(s), self._stacked(values)[interval])

    def split(self, which: NDArray[np.bool_]) -> tuple["Points", NDArray[np.bool_]]:
        """With some intervals cut in two, and which of the new ones are near a cut."""
        middle = 0.5 * (self.knots[:-1] + self.knots[1:])[which]
        knots = np.sort(np.concatenate((self.knots, middle)))
        inner, reach = 0.5 * (knots[:-1] + knots[1:])[:, None], _NEAR * np.diff(self.knots).max()
        begins, ends = self.knots[:-1][which] - reach, self.knots[1:][which] + reach
        return Points(knots, self.scheme), ((inner > begins) & (inner < ends)).any(axis=1)

    def at_starts(self, values: Array, finer: "Points") -> Array:
        """What is given at starts of intervals, at those of finer ones."""
        columns = [np.interp(finer.knots[:-1], self.knots[:-1], one) for one in values.T]
        return np.stack(columns, axis=1)

    def _stacked(self, values: Array) -> Array:
        return values[1:].reshape(len(self.knots) - 1, self.scheme.degree, values.shape[1])

    def _find(self, t: Array) -> tuple[Any, Array]:
        interval = np.clip(np.searchsorted(self.knots, t, "right") - 1, 0, len(self.knots) - 2)
        h = np.diff(self.knots)[interval]
        return interval, (t - self.knots[interval]) / h


def graded(duration: float, count: int) -> Array:
    """Ends of equal intervals, of which the first and the last are halved towards the ends."""
    knots = np.linspace(0.0, duration, count + 1)
    short = knots[1] * 0.5 ** np.arange(_HALVED, 0, -1)
    found: Array = np.unique(np.concatenate((knots, short, duration - short)))
    return found
