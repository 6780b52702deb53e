"""The window of a moving horizon as a chain: forward by covariances, back by costates.

For d_i+1 = F d_i + gap + G w_i, a prior of d_0 and white measurements r_i = H_i d_i the optimum is

    e = r - H m,   m+ = m + K e + P+ h,   m_i+1 = F m+ + gap + G Q nu               (forward)
    d = m+ - P+ lam,   p = lam - h,   lam- = p - H' (S^-1 e + K' p),   lam_i-1 = F' lam-  (back)
    w = Q (nu - G' lam-)

h and nu are multipliers of bounds on d and w. A new sample changes means; covariances change only
behind a node that was linearised again. Sources: H. E. Rauch, F. Tung, C. T. Striebel,
AIAA J. 3(8) (1965); A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, sec. 13.2, on costates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NONE as _NONE
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.methods.estimation.process import Bounded, Observation, Process, Transition

Sides = NDArray[np.int8]  # 1 at the lower bound, -1 at the upper one
_KEPT = 1.0e-10  # what a row may be beyond its bound, of its size
_CERTAIN = 30.0  # deviations from a bound to what is measured, from which on the bound is wrong
_JITTER = 1.0e-13  # of rows that nearly say the same
_CHANGES = 300  # of rows
_AT_ONCE = 20  # changes of several rows, then of single ones


class HorizonChain:
    """Solves the windows of a horizon with a prior.

    Args:
        lower: Smallest disturbances, shape (nw,).
        upper: Largest disturbances, shape (nw,).

    Attributes:
        released: Bounds of states that measurements contradict, by their place.
    """

    def __init__(self, process: Process, lower: Array, upper: Array) -> None:
        self._process, self._lower, self._upper = process, lower, upper
        self._whitening, self._unity = Whitening(), np.eye(process.n)
        self.released = set[int]()
        self._acting: tuple[float, Sides] | None = None  # time of the newest node, rows that act

    def solve(self, nodes: Sequence[Node], arrival: Arrival) -> Answer:
        """Steps of all nodes.

        Args:
            nodes: From the oldest to the newest.
            arrival: Of the first one, with a covariance.

        Raises:
            SolveError: A covariance is not positive, or bounds contradict one another.
        """
        assert arrival.P is not None
        links = self._links(nodes, arrival.P)
        first = self._process.minus(arrival.x, nodes[0].x)
        free = sweep(nodes, links, first, None)
        bounds = WindowBounds(nodes, self._lower, self._upper)
        bounds.leave_out(self.released, free)
        beyond = bounds.beyond(*free)
        if not beyond.any():
            self._acting = None
            return Answer(free[0], links[-1].after, 0.0, 0, free[1])
        return self._held(nodes, links, bounds, free)

    def ahead(self, node: Node, going: Transition) -> Array:
        """Covariance behind a node that has a link, before the next measurement."""
        link = node.link
        assert link is not None
        if link.going is not going:
            P = going.F.dot(link.after).dot(going.F.T) + going.noise
            link.going, link.ahead = going, 0.5 * (P + P.T)
        return link.ahead

    def _links(self, nodes: Sequence[Node], P: Array) -> list[Link]:
        process, last = self._process, len(nodes) - 1
        for i, node in enumerate(nodes):
            link = node.link
            if link is None or link.before is not P or link.seen is not node.seen:
                link = node.link = self._linked(node, P)
            if i == last:
                break
            going, following = node.going, nodes[i + 1]
            assert going is not None
            P = self.ahead(node, going)
            if link.next_x is not following.x or link.F is not going.F:
                link.next_x, link.F, link.G = following.x, going.F, going.G
                link.gap = process.minus(going.x, following.x)
                turn = process.turned(going.x, following.x)
                if turn is not None:
                    link.G = turn.dot(going.G)
                    link.gap, link.turned = turn.dot(link.gap), turn.dot(going.F)
                    link.ahead_turned = turn.dot(P).dot(turn.T)
                else:
                    link.turned, link.ahead_turned = going.F, P
            P = link.ahead_turned
        return [node.link for node in nodes if node.link is not None]

    def _linked(self, node: Node, P: Array) -> Link:
        """Covariance and gain of a measurement of unit noise."""
        assert node.seen is not None
        told, (y, slope, R) = np.isfinite(node.values), node.seen
        if not told.any():
            none = np.zeros((0, len(P)))
            return Link(P, node.seen, none, np.zeros(0), none.T, np.zeros((0, 0)), P)
        whiten = self._whitening.of(R, told)
        H = whiten.dot(slope[told])
        r = whiten.dot(node.values[told] - y[told])
        HP = H.dot(P)
        S = HP.dot(H.T)
        S.flat[:: len(S) + 1] += 1.0
        factor = eigenpy.LLT(S)
        if factor.info() != eigenpy.ComputationInfo.Success:
            raise SolveError("the covariance of the innovation is not positive definite")
        K = factor.solve(HP).reshape(HP.shape).T
        rest = self._unity - K.dot(H)
        after = rest.dot(P).dot(rest.T) + K.dot(K.T)
        weight = np.asarray(factor.solve(np.eye(len(r)))).reshape(len(r), len(r))
        return Link(P, node.seen, H, r, K, weight, 0.5 * (after + after.T))

    def _held(
        self,
        nodes: Sequence[Node],
        links: Sequence[Link],
        bounds: WindowBounds,
        free: tuple[Array, Array],
    ) -> Answer:
        """The answer with all bounds kept.

        Raises:
            SolveError: Exchanges do not end.
        """
        sides, known = self._guess(nodes, bounds), Responses(nodes, links, bounds, free)
        worst = bounds.worst(bounds.beyond(*free), *free, is_alone=False)
        known.add(np.flatnonzero((sides != 0) | (worst != 0)))
        self._acting = None
        while True:
            sides, push = exchanged(bounds, known, sides)
            rows = np.flatnonzero(sides)
            gone = bounds.give_way(rows, push * (bounds.sided(sides) - known.outside(rows)))
            if not len(gone):
                break
            self.released |= set(gone.tolist())
            sides[:, gone] = 0
        self._acting = nodes[-1].t, sides
        steps, w = known.moved(rows, push)
        there = bounds.values(steps, w).ravel()[rows]
        residual = float(np.abs(there - bounds.sided(sides)).max(initial=0.0))
        return Answer(steps, links[-1].after, residual, len(rows), w)

    def _guess(self, nodes: Sequence[Node], bounds: WindowBounds) -> Sides:
        """Rows that acted in the last answer, as far as they are still in the window."""
        sides = np.zeros(bounds.shape, dtype=np.int8)
        if self._acting is None:
            return sides
        t, before = self._acting
        end = len(nodes) - int(t < nodes[-1].t)
        count = min(end, len(before))
        if before.shape[1] == sides.shape[1] and count:
            sides[end - count : end] = before[len(before) - count :]
        return np.where(bounds.exist, sides, 0).astype(np.int8)


@dataclass
class Node:
    """One time of the window.

    Attributes:
        t: Time [s].
        x: State about which it is linearised.
        values: What was measured, NaN where nothing was or where it does not count, shape (m,).
        u: Inputs after it.
        going: To the next node, linearised at x; None at the end.
        seen: Linearised at x.
        link: What a chain knows of it.
    """

    t: float
    x: Any
    values: Array
    u: Array | None = None
    going: Transition | None = None
    seen: Observation | None = None
    bounded: Bounded | None = None
    link: Link | None = None


def _unknown() -> Array:
    return _NONE


@dataclass
class Link:
    """What a chain knows of a node, see `horizon_chain`; measurements have unit noise.

    Attributes:
        before: Covariance before the measurement, shape (n, n).
        seen: About which it is linearised.
        H: Shape (m, n).
        r: Measured less expected, shape (m,).
        K: Gain, shape (n, m).
        weight: Inverse of the covariance of the innovation, shape (m, m).
        after: Covariance after the measurement, shape (n, n).
        going: The interval behind it; None while there is none.
        ahead: Covariance at its end, in the tangent there.
        next_x: The state of the next node.
        F: Of `going`.
        turned: F, to the tangent of the next node.
        G: Of `going`, to the tangent of the next node.
        gap: From the next node to the end of the interval, in the tangent of that node.
        ahead_turned: `ahead`, in the tangent of the next node.
    """

    before: Array
    seen: Observation
    H: Array
    r: Array
    K: Array
    weight: Array
    after: Array
    going: Transition | None = None
    ahead: Array = field(default_factory=_unknown)
    next_x: Any = None
    F: Array | None = None
    turned: Array = field(default_factory=_unknown)
    G: Array = field(default_factory=_unknown)
    gap: Array = field(default_factory=_unknown)
    ahead_turned: Array = field(default_factory=_unknown)


class Answer(NamedTuple):
    """What a solve of the window found.

    Attributes:
        steps: From the states of the nodes, one row a node, shape (count, n).
        P: Covariance of the last one, where no bound acts, shape (n, n).
        residual: Of the conditions of the optimum.
        active: How many bounds act.
        w: Disturbances, shape (count - 1, nw).
    """

    steps: Array
    P: Array
    residual: float
    active: int
    w: Array


class Arrival(NamedTuple):
    """What is known of the first node before its measurements.

    Attributes:
        P: Covariance, shape (n, n); None where nothing is known.
    """

    x: Any
    P: Array | None


class Whitening:
    """W with W R W' = 1 for what was measured; the last one is kept."""

    def __init__(self) -> None:
        self._known: tuple[Array, NDArray[np.bool_], Array] | None = None

    def of(self, R: Array, told: NDArray[np.bool_]) -> Array:
        """W, shape as many as told.

        Args:
            R: Covariance of the noise, shape (m, m).
            told: What was measured, shape (m,).
        """
        known = self._known
        if known is None or known[0] is not R or not np.array_equal(known[1], told):
            factor = np.linalg.cholesky(R[np.ix_(told, told)])
            self._known = known = R, told.copy(), np.linalg.inv(factor)
        return known[2]


def sweep(
    nodes: Sequence[Node],
    links: Sequence[Link],
    first: Array,
    pushes: tuple[dict[int, Array], dict[int, Array]] | None,
) -> tuple[Array, Array]:
    """Steps and disturbances: of the window, or what multipliers of bounds add to them.

    Args:
        nodes: Of the window.
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


def exchanged(bounds: WindowBounds, known: Responses, sides: Sides) -> tuple[Sides, Array]:
    """Rows that act at the optimum, and their multipliers: least squares with signs.

    Of each row of the nodes the worst one is taken in at a time, of all of them where that takes
    long, which always ends.

    Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, ch. 23.

    Args:
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
