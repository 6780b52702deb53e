"""Bounds of the states of a window and of the disturbances between them, as rows."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.estimation.horizon_nodes import Node
from mbd_ros.core.state import Array

Sides = NDArray[np.int8]  # 1 at the lower bound, -1 at the upper one
_KEPT = 1.0e-10  # what a row may be beyond its bound, of its size
_CERTAIN = 30.0  # deviations from a bound to what is measured, from which on the bound is wrong


class WindowBounds:
    """Rows of a window: those of each node, then those of the disturbance behind it.

    Args:
        nodes: Of the window, all with bounds of the same rows, or none.
        lower: Smallest disturbances, shape (nw,).
        upper: Largest disturbances, shape (nw,).

    Attributes:
        shape: Nodes, and rows of each.
        exist: Which rows there are and count, of that shape.
        are_equal: Which rows have one bound on both sides, flat.
        lower_w: As given.
    """

    def __init__(self, nodes: Sequence[Node], lower: Array, upper: Array) -> None:
        self.lower_w = lower
        every = [node.bounded for node in nodes]
        held = [one for one in every if one is not None]
        self._b = len(held[0].values) if len(held) == len(every) else 0
        self._which = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        count = len(nodes)
        self.shape = count, self._b + len(self._which)
        self._lower, self._upper = np.full((2, *self.shape), -np.inf)
        self._upper[:] = np.inf
        if self._b:
            self._here = np.array([one.values for one in held])
            self._by = [one.by for one in held]
            self._lower[:, : self._b] = [one.lower for one in held]
            self._upper[:, : self._b] = [one.upper for one in held]
            self._may_be_wrong = held[0].may_be_wrong
        if len(self._which):
            self._lower[:-1, self._b :] = lower[self._which]
            self._upper[:-1, self._b :] = upper[self._which]
        self.exist = np.isfinite(self._lower) | np.isfinite(self._upper)
        self.are_equal = (self._lower >= self._upper).ravel()

    def values(self, steps: Array, w: Array) -> Array:
        """What the rows bound, of their shape."""
        found = np.zeros(self.shape)
        if self._b:
            by = self._by
            if all(one is by[0] for one in by):
                moved = steps.dot(by[0].T)
            else:
                moved = np.einsum("ibn,in->ib", np.array(by), steps)
            found[:, : self._b] = self._here + moved
        if len(self._which) and len(w):
            found[:-1, self._b :] = w[:, self._which]
        return found

    def beyond(self, steps: Array, w: Array) -> Sides:
        """Bounds that are passed."""
        there = self.values(steps, w)
        slack = _KEPT * (1.0 + np.abs(there))
        low, high = there < self._lower - slack, there > self._upper + slack
        sides: Sides = np.where(self.exist, low.astype(np.int8) - high.astype(np.int8), 0)
        return sides

    def leave_out(self, released: set[int], free: tuple[Array, Array]) -> None:
        """Leave out bounds that were found to be wrong, as long as they are passed.

        Args:
            released: Their places; those that are kept again are taken out.
            free: Steps and disturbances where no bound acts.
        """
        if released:
            beyond = self.beyond(*free).any(axis=0)
            released &= set(np.flatnonzero(beyond).tolist())
            self.exist[:, sorted(released)] = False

    def worst(self, beyond: Sides, steps: Array, w: Array, *, is_alone: bool) -> Sides:
        """The node at which each row is farthest beyond its bound; one row where it is alone."""
        there = self.values(steps, w)
        off = np.where(beyond > 0, self._lower - there, there - self._upper)
        off, found = np.where(beyond != 0, off, -1.0), np.zeros_like(beyond)
        columns = np.arange(off.shape[1])
        nodes = off.argmax(axis=0)
        if is_alone:
            columns = columns[[int(off[nodes, columns].argmax())]]
        at = nodes[columns], columns
        found[at] = beyond[at]
        return found

    def give_way(self, rows: NDArray[np.intp], shares: Array) -> NDArray[np.intp]:
        """Leave out bounds that measurements contradict beyond doubt; returns their columns.

        Args:
            rows: That act, flat.
            shares: What each adds to the squared and normalised misfit.
        """
        if not self._b or self._may_be_wrong is None:
            return np.zeros(0, dtype=np.intp)
        total = np.bincount(rows % self.shape[1], shares, minlength=self.shape[1])[: self._b]
        wrong = np.flatnonzero((total > _CERTAIN**2) & self._may_be_wrong)
        self.exist[:, wrong] = False
        return wrong

    def sided(self, sides: Sides) -> Array:
        """The bounds of the rows that act, in their order."""
        chosen = sides != 0
        return np.where(sides > 0, self._lower, self._upper)[chosen]

    def pushes(self, rows: Sequence[int]) -> tuple[dict[int, Array], dict[int, Array]]:
        """Unit multipliers of rows, by node: of states, shape (n, k), and disturbances."""
        h, nu = dict[int, Array](), dict[int, Array]()
        for k, row in enumerate(rows):
            i, j = divmod(row, self.shape[1])
            if j < self._b:
                n = self._by[i].shape[1]
                h.setdefault(i, np.zeros((n, len(rows))))[:, k] = self._by[i][j]
            else:
                block = nu.setdefault(i, np.zeros((len(self.lower_w), len(rows))))
                block[self._which[j - self._b], k] = 1.0
        return h, nu

    def changes(self, rows: NDArray[np.intp], steps: Array, w: Array) -> Array:
        """What rows change by, shape (rows, k).

        Args:
            rows: Flat.
            steps: Of the nodes, shape (count, n, k).
            w: Of disturbances, shape (count - 1, nw, k).
        """
        nodes, at = np.divmod(rows, self.shape[1])
        found = np.empty((len(rows), steps.shape[2]))
        states = at < self._b
        if states.any():
            pairs = zip(nodes[states].tolist(), at[states].tolist(), strict=True)
            by = np.array([self._by[i][j] for i, j in pairs])
            found[states] = np.einsum("rn,rnk->rk", by, steps[nodes[states]])
        if not states.all():
            found[~states] = w[nodes[~states], self._which[at[~states] - self._b]]
        return found
