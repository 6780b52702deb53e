"""Sweeps along a chain of nodes, and which bounds act; equations stand in `horizon_chain`."""

from collections.abc import Sequence

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.estimation.horizon_nodes import Link, Node
from mbd_ros.core.estimation.window_bounds import Sides, WindowBounds
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

_JITTER = 1.0e-13  # of rows that nearly say the same
_CHANGES = 300  # of rows
_AT_ONCE = 20  # changes of several rows, then of single ones


def sweep(
    nodes: Sequence[Node],
    links: Sequence[Link],
    first: Array,
    pushes: tuple[dict[int, Array], dict[int, Array]] | None,
) -> tuple[Array, Array]:
    """Steps and disturbances: of the window, or what multipliers of bounds add to them.

    Args:
        nodes: Of the window.
        links: Theirs.
        first: Prior mean of the first step, shape (n,) or (n, k).
        pushes: Multipliers h and nu by node, shape (n, k) and (nw, k); None without any.
    """
    is_window, m, after, off = pushes is None, first, [], []
    h, nu = ({}, {}) if pushes is None else pushes
    last = len(links) - 1
    for i, link in enumerate(links):
        e = link.r - link.H.dot(m) if is_window else -link.H.dot(m)
        off.append(e)
        m = m + link.K.dot(e)
        if i in h:
            m = m + link.after.dot(h[i])
        after.append(m)
        if i < last:
            m = link.turned.dot(m)
            if is_window:
                m = m + link.gap
            if i in nu:
                m = m + link.G.dot(nodes[i].going.Q.dot(nu[i]))  # type: ignore[union-attr]
    steps, w = np.empty((len(links), *first.shape)), []
    lam = np.zeros(first.shape)
    for i in range(last, -1, -1):
        link = links[i]
        if i < last:
            pushed = -link.G.T.dot(lam)
            if i in nu:
                pushed = pushed + nu[i]
            w.append(nodes[i].going.Q.dot(pushed))  # type: ignore[union-attr]
            lam = link.turned.T.dot(lam)
        steps[i] = after[i] - link.after.dot(lam)
        if i in h:
            lam = lam - h[i]
        lam = lam - link.H.T.dot(link.weight.dot(off[i]) + link.K.T.dot(lam))
    return steps, np.array(w[::-1])


class Responses:
    """What multipliers of rows add to the steps and disturbances of a window.

    Args:
        nodes: Of the window.
        links: Theirs.
        bounds: Their rows.
        free: Steps and disturbances where no row acts.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        links: Sequence[Link],
        bounds: WindowBounds,
        free: tuple[Array, Array],
    ) -> None:
        self._nodes, self._links, self._bounds, self._free = nodes, links, bounds, free
        self._outside = bounds.values(*free).ravel()
        self._at = dict[int, int]()
        n, nw = links[0].before.shape[0], len(bounds.lower_w)
        self._steps, self._w = np.zeros((len(nodes), n, 0)), np.zeros((len(nodes) - 1, nw, 0))
        self._table = np.zeros((0, 0))

    def add(self, rows: NDArray[np.intp]) -> None:
        """Find those of new rows, all in one sweep."""
        new = [row for row in rows.tolist() if row not in self._at]
        if not new:
            return
        pushes = self._bounds.pushes(new)
        n = self._steps.shape[1]
        steps, w = sweep(self._nodes, self._links, np.zeros((n, len(new))), pushes)
        w = w.reshape(*self._w.shape[:2], len(new))
        self._at |= {row: len(self._at) + k for k, row in enumerate(new)}
        self._steps = np.concatenate((self._steps, steps), axis=2)
        self._w = np.concatenate((self._w, w), axis=2)
        columns = self._bounds.changes(np.array(list(self._at)), steps, w)
        own = columns[: len(self._table)]
        self._table = np.block([[self._table, own], [own.T, columns[len(own) :]]])

    def outside(self, rows: NDArray[np.intp]) -> Array:
        """What rows bound where none acts."""
        return self._outside[rows]

    def multipliers(self, rows: NDArray[np.intp], sides: Sides) -> Array:
        """Those that put rows on their bounds, all of them and no others."""
        self.add(rows)
        return solved(self.table(rows), self._bounds.sided(sides) - self._outside[rows])

    def table(self, rows: NDArray[np.intp]) -> Array:
        """Change of each row by the multiplier of each row, symmetric, shape (k, k)."""
        at = [self._at[row] for row in rows.tolist()]
        return self._table[np.ix_(at, at)]

    def moved(self, rows: NDArray[np.intp], push: Array) -> tuple[Array, Array]:
        """Steps and disturbances under multipliers."""
        whole = np.zeros(len(self._at))
        whole[[self._at[row] for row in rows.tolist()]] = push
        steps, w = self._free
        return steps + self._steps.dot(whole), w + self._w.dot(whole) if len(w) else w


def exchanged(bounds: WindowBounds, known: Responses, sides: Sides) -> tuple[Sides, Array]:
    """Rows that act at the optimum, and their multipliers: least squares with signs.

    Of each row of the nodes the worst one is taken in at a time, of all of them where that takes
    long, which always ends.

    Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, ch. 23.

    Args:
        bounds: The rows.
        known: What their multipliers do.
        sides: Rows that act, as far as one can guess.

    Raises:
        SolveError: Exchanges do not end.
    """
    push = np.zeros(bounds.exist.size)
    while True:
        rows = np.flatnonzero(sides)
        wanted = known.multipliers(rows, sides)
        wrong = (wanted * sides.ravel()[rows] <= 0.0) & ~bounds.are_equal[rows]
        if not wrong.any():
            break
        sides.flat[rows[wrong]] = 0
    push[rows] = wanted
    for k in range(_CHANGES):
        rows = np.flatnonzero(sides)
        steps, w = known.moved(rows, push[rows])
        beyond = np.where(sides == 0, bounds.beyond(steps, w), 0).astype(np.int8)
        if not beyond.any():
            return sides, push[rows]
        sides = sides + bounds.worst(beyond, steps, w, is_alone=k >= _AT_ONCE)
        _shortened(bounds, known, sides, push)
    raise SolveError("the bounds of the window contradict one another")


def _shortened(bounds: WindowBounds, known: Responses, sides: Sides, push: Array) -> None:
    """Go towards the multipliers of the rows as far as none pulls, and leave out those that do."""
    while True:
        rows = np.flatnonzero(sides)
        wanted, signs = known.multipliers(rows, sides), sides.ravel()[rows]
        wrong = (wanted * signs <= 0.0) & ~bounds.are_equal[rows]
        if not wrong.any():
            push[rows] = wanted
            return
        shares = np.full(len(rows), np.inf)
        shares[wrong] = push[rows[wrong]] / (push[rows[wrong]] - wanted[wrong])
        push[rows] += shares.min() * (wanted - push[rows])
        left = rows[shares <= shares.min()]
        push[left], sides.flat[left] = 0.0, 0


def solved(S: Array, right: Array) -> Array:
    """Multipliers, by the least ones where rows say the same."""
    if not len(right):
        return right
    for jitter in (0.0, _JITTER * float(S.diagonal().max())):
        factor = eigenpy.LLT(S + jitter * np.eye(len(S)))
        if factor.info() == eigenpy.ComputationInfo.Success:
            push = factor.solve(right).ravel()
            return np.asarray(push + factor.solve(right - S.dot(push)).ravel())
    return np.asarray(np.linalg.lstsq(S, right, rcond=None)[0])
