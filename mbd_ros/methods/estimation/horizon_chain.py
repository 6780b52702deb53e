"""Moving-horizon estimation by sweeps: covariances forward, costates backward.

The steps d_i satisfy d_i+1 = F d_i + gap + G w_i, with a prior of d_0 and measurements
r_i = H_i d_i of unit noise. The optimum is

    e = r - H m,   m+ = m + K e + P+ h,   m_i+1 = F m+ + gap + G Q nu               (forward)
    d = m+ - P+ lam,   p = lam - h,   lam- = p - H' (S^-1 e + K' p),   lam_i-1 = F' lam-  (back)
    w = Q (nu - G' lam-)

h and nu are multipliers of bounds on d and w. A new sample changes all means, but covariances only
behind nodes that are linearised again. Sources: H. E. Rauch, F. Tung, C. T. Striebel,
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
from mbd_ros.methods.estimation.process import Observation, Process, StateBounds, Transition

Sides = NDArray[np.int8]  # 1 at the lower bound, -1 at the upper one
_TOLERANCE = 1.0e-10  # accepted excess over a bound, relative to 1 + the value
_CERTAIN = 30.0  # standard deviations beyond which measurements refute a bound
_JITTER = 1.0e-13  # relative regularisation of nearly dependent rows
_CHANGES = 300  # largest number of changes of the active set
_AT_ONCE = 20  # changes with several rows each; later ones add single rows


class HorizonChain:
    """Solves windows of a moving horizon that have a prior.

    Args:
        lower: Lower bounds of the disturbances, shape (nw,).
        upper: Upper bounds of the disturbances, shape (nw,).

    Attributes:
        released: Indices of bounds of states that measurements contradict.
    """

    def __init__(self, process: Process, lower: Array, upper: Array) -> None:
        self._process = process
        self._lower = lower
        self._upper = upper
        self._whitening = Whitening()
        self._unity = np.eye(process.n)
        self.released = set[int]()
        self._active: tuple[float, Sides] | None = None  # time of the newest node, active rows

    def solve(self, nodes: Sequence[Node], arrival: Arrival) -> WindowSolution:
        """Solve for the steps of all nodes.

        Args:
            nodes: Nodes of the window, from the oldest to the newest.
            arrival: Prior of the first node, with a covariance.

        Raises:
            SolveError: A covariance is not positive definite, or the bounds are infeasible.
        """
        assert arrival.P is not None
        links = self._links(nodes, arrival.P)
        first = self._process.minus(arrival.x, nodes[0].x)
        free = sweep(nodes, links, first, None)
        bounds = WindowBounds(nodes, self._lower, self._upper)
        bounds.exclude(self.released, free)
        violated = bounds.find_violated(*free)
        if not violated.any():
            self._active = None
            return WindowSolution(free[0], links[-1].after, 0.0, 0, free[1])
        return self._solve_bounded(nodes, links, bounds, free)

    def predict_covariance(self, node: Node, transition: Transition) -> Array:
        """Return the covariance after the interval behind a node that has a link."""
        link = node.link
        assert link is not None
        if link.transition is not transition:
            P = transition.F.dot(link.after).dot(transition.F.T) + transition.noise
            link.transition = transition
            link.predicted = 0.5 * (P + P.T)
        return link.predicted

    def _links(self, nodes: Sequence[Node], P: Array) -> list[Link]:
        process, last = self._process, len(nodes) - 1
        for i, node in enumerate(nodes):
            link = node.link
            if link is None or link.before is not P or link.observation is not node.observation:
                link = node.link = self._create_link(node, P)
            if i == last:
                break
            transition, following = node.transition, nodes[i + 1]
            assert transition is not None
            P = self.predict_covariance(node, transition)
            if link.next_x is not following.x or link.local_F is not transition.F:
                link.next_x = following.x
                link.local_F = transition.F
                link.gap = process.minus(transition.x, following.x)
                T = process.transport(transition.x, following.x)
                if T is None:
                    link.F = transition.F
                    link.G = transition.G
                    link.prior = P
                else:
                    link.F = T.dot(transition.F)
                    link.G = T.dot(transition.G)
                    link.gap = T.dot(link.gap)
                    link.prior = T.dot(P).dot(T.T)
            P = link.prior
        return [node.link for node in nodes if node.link is not None]

    def _create_link(self, node: Node, P: Array) -> Link:
        """Compute gain and covariance of a measurement that is scaled to unit noise."""
        assert node.observation is not None
        measured, (y, slope, R) = np.isfinite(node.values), node.observation
        if not measured.any():
            none = np.zeros((0, len(P)))
            return Link(P, node.observation, none, np.zeros(0), none.T, np.zeros((0, 0)), P)
        whiten = self._whitening.matrix(R, measured)
        H = whiten.dot(slope[measured])
        r = whiten.dot(node.values[measured] - y[measured])
        HP = H.dot(P)
        S = HP.dot(H.T)
        S.flat[:: len(S) + 1] += 1.0
        factor = eigenpy.LLT(S)
        if factor.info() != eigenpy.ComputationInfo.Success:
            raise SolveError("the covariance of the innovation is not positive definite")
        K = factor.solve(HP).reshape(HP.shape).T
        reduction = self._unity - K.dot(H)
        after = reduction.dot(P).dot(reduction.T) + K.dot(K.T)
        weight = np.asarray(factor.solve(np.eye(len(r)))).reshape(len(r), len(r))
        return Link(P, node.observation, H, r, K, weight, 0.5 * (after + after.T))

    def _solve_bounded(
        self,
        nodes: Sequence[Node],
        links: Sequence[Link],
        bounds: WindowBounds,
        free: tuple[Array, Array],
    ) -> WindowSolution:
        """Solve with all bounds, by an active-set method.

        Raises:
            SolveError: The active set does not settle.
        """
        sides, responses = self._guess(nodes, bounds), Responses(nodes, links, bounds, free)
        worst = bounds.worst(bounds.find_violated(*free), *free, only_one=False)
        responses.add(np.flatnonzero((sides != 0) | (worst != 0)))
        self._active = None
        while True:
            sides, lam = solve_active_set(bounds, responses, sides)
            rows = np.flatnonzero(sides)
            misfit = lam * (bounds.active_bounds(sides) - responses.unbounded_values(rows))
            released = bounds.release_contradicted(rows, misfit)
            if not len(released):
                break
            self.released |= set(released.tolist())
            sides[:, released] = 0
        self._active = nodes[-1].t, sides
        steps, w = responses.motion(rows, lam)
        values = bounds.values(steps, w).ravel()[rows]
        residual = float(np.abs(values - bounds.active_bounds(sides)).max(initial=0.0))
        return WindowSolution(steps, links[-1].after, residual, len(rows), w)

    def _guess(self, nodes: Sequence[Node], bounds: WindowBounds) -> Sides:
        """Return the active rows of the last solution that are still in the window."""
        sides = np.zeros(bounds.shape, dtype=np.int8)
        if self._active is None:
            return sides
        t, before = self._active
        end = len(nodes) - int(t < nodes[-1].t)
        count = min(end, len(before))
        if before.shape[1] == sides.shape[1] and count:
            sides[end - count : end] = before[len(before) - count :]
        return np.where(bounds.exist, sides, 0).astype(np.int8)


@dataclass
class Node:
    """One sample of the window.

    Attributes:
        t: Time [s].
        x: State about which the node is linearised.
        values: Measured values, NaN where not measured or not used, shape (m,).
        u: Inputs after it.
        transition: Interval to the next node, linearised at x; None for the last node.
        observation: Expected measurement, linearised at x.
        bounds: Bounded quantities, linearised at x; None without bounds.
        link: Cached results of the forward sweep.
    """

    t: float
    x: Any
    values: Array
    u: Array | None = None
    transition: Transition | None = None
    observation: Observation | None = None
    bounds: StateBounds | None = None
    link: Link | None = None


def _unset() -> Array:
    return _NONE


@dataclass
class Link:
    """Results of the forward sweep at a node, with measurements scaled to unit noise.

    Attributes:
        before: Covariance before the measurement, shape (n, n).
        observation: Linearised measurement of the node.
        H: Derivative of the scaled measurement, shape (m, n).
        r: Scaled measured minus expected values, shape (m,).
        K: Gain, shape (n, m).
        weight: Inverse of the covariance of the innovation, shape (m, m).
        after: Covariance after the measurement, shape (n, n).
        transition: Interval behind the node; None before it is known.
        predicted: Covariance at the end of the interval, in the tangent there.
        next_x: State of the next node.
        local_F: `Transition.F`, to the tangent at the end of the interval.
        F: `Transition.F`, to the tangent of the next node.
        G: `Transition.G`, to the tangent of the next node.
        gap: Step from the next node to the end of the interval, in the tangent of that node.
        prior: `predicted`, in the tangent of the next node.
    """

    before: Array
    observation: Observation
    H: Array
    r: Array
    K: Array
    weight: Array
    after: Array
    transition: Transition | None = None
    predicted: Array = field(default_factory=_unset)
    next_x: Any = None
    local_F: Array | None = None
    F: Array = field(default_factory=_unset)
    G: Array = field(default_factory=_unset)
    gap: Array = field(default_factory=_unset)
    prior: Array = field(default_factory=_unset)


class WindowSolution(NamedTuple):
    """Solution of the program of a window.

    Attributes:
        steps: Tangent step of each node, one a row, shape (count, n).
        P: Covariance of the last node, regardless of active bounds, shape (n, n).
        residual: Residual of the optimality conditions.
        active: Number of active bounds.
        w: Disturbances between the nodes, shape (count - 1, nw).
    """

    steps: Array
    P: Array
    residual: float
    active: int
    w: Array


class Arrival(NamedTuple):
    """Prior of the first node of a window, before its measurement.

    Attributes:
        x: Mean.
        P: Covariance, shape (n, n); None without a prior.
    """

    x: Any
    P: Array | None


class Whitening:
    """Scaling of measurements to unit noise, with a cache for the last covariance."""

    def __init__(self) -> None:
        self._known: tuple[Array, NDArray[np.bool_], Array] | None = None

    def matrix(self, R: Array, measured: NDArray[np.bool_]) -> Array:
        """Return W with W R W' = 1 for the measured values.

        Args:
            R: Covariance of the noise, shape (m, m).
            measured: Which values were measured, shape (m,).
        """
        known = self._known
        if known is None or known[0] is not R or not np.array_equal(known[1], measured):
            factor = np.linalg.cholesky(R[np.ix_(measured, measured)])
            self._known = known = R, measured.copy(), np.linalg.inv(factor)
        return known[2]


def sweep(
    nodes: Sequence[Node],
    links: Sequence[Link],
    first: Array,
    multipliers: tuple[dict[int, Array], dict[int, Array]] | None,
) -> tuple[Array, Array]:
    """Return steps and disturbances of a window, or their response to multipliers of bounds.

    Args:
        nodes: Nodes of the window.
        links: Results of the forward sweep.
        first: Prior mean of the first step, shape (n,) or (n, k).
        multipliers: Multipliers h and nu by node, shape (n, k) and (nw, k). With None, the
            result is that of the window without bounds.
    """
    is_window, m, after, innovations = multipliers is None, first, [], []
    h, nu = ({}, {}) if multipliers is None else multipliers
    last = len(links) - 1
    for i, link in enumerate(links):
        e = link.r - link.H.dot(m) if is_window else -link.H.dot(m)
        innovations.append(e)
        m = m + link.K.dot(e)
        if i in h:
            m = m + link.after.dot(h[i])
        after.append(m)
        if i < last:
            m = link.F.dot(m)
            if is_window:
                m = m + link.gap
            if i in nu:
                m = m + link.G.dot(nodes[i].transition.Q.dot(nu[i]))  # type: ignore[union-attr]
    steps, w = np.empty((len(links), *first.shape)), []
    lam = np.zeros(first.shape)
    for i in range(last, -1, -1):
        link = links[i]
        if i < last:
            gradient = -link.G.T.dot(lam)
            if i in nu:
                gradient = gradient + nu[i]
            w.append(nodes[i].transition.Q.dot(gradient))  # type: ignore[union-attr]
            lam = link.F.T.dot(lam)
        steps[i] = after[i] - link.after.dot(lam)
        if i in h:
            lam = lam - h[i]
        lam = lam - link.H.T.dot(link.weight.dot(innovations[i]) + link.K.T.dot(lam))
    return steps, np.array(w[::-1])


class Responses:
    """Response of steps and disturbances of a window to unit multipliers of its bounds.

    Args:
        nodes: Nodes of the window.
        links: Results of the forward sweep.
        bounds: Bounds of the window.
        free: Steps and disturbances without active bounds.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        links: Sequence[Link],
        bounds: WindowBounds,
        free: tuple[Array, Array],
    ) -> None:
        self._nodes = nodes
        self._links = links
        self._bounds = bounds
        self._free = free
        self._unbounded_values = bounds.values(*free).ravel()
        self._at = dict[int, int]()  # row -> index of its response
        n, nw = links[0].before.shape[0], len(bounds.lower_w)
        self._steps = np.zeros((len(nodes), n, 0))
        self._w = np.zeros((len(nodes) - 1, nw, 0))
        self._table = np.zeros((0, 0))

    def add(self, rows: NDArray[np.intp]) -> None:
        """Compute the responses of new rows, all in one sweep."""
        new = [row for row in rows.tolist() if row not in self._at]
        if not new:
            return
        multipliers = self._bounds.unit_multipliers(new)
        n = self._steps.shape[1]
        steps, w = sweep(self._nodes, self._links, np.zeros((n, len(new))), multipliers)
        w = w.reshape(*self._w.shape[:2], len(new))
        self._at |= {row: len(self._at) + k for k, row in enumerate(new)}
        self._steps = np.concatenate((self._steps, steps), axis=2)
        self._w = np.concatenate((self._w, w), axis=2)
        columns = self._bounds.changes(np.array(list(self._at)), steps, w)
        known = columns[: len(self._table)]
        self._table = np.block([[self._table, known], [known.T, columns[len(known) :]]])

    def unbounded_values(self, rows: NDArray[np.intp]) -> Array:
        """Return the values that rows bound, without active bounds."""
        return self._unbounded_values[rows]

    def multipliers(self, rows: NDArray[np.intp], sides: Sides) -> Array:
        """Return the multipliers that put exactly these rows on their bounds."""
        self.add(rows)
        excess = self._bounds.active_bounds(sides) - self._unbounded_values[rows]
        return solve_multipliers(self.table(rows), excess)

    def table(self, rows: NDArray[np.intp]) -> Array:
        """Return the change of each row by each multiplier, symmetric, shape (k, k)."""
        at = [self._at[row] for row in rows.tolist()]
        return self._table[np.ix_(at, at)]

    def motion(self, rows: NDArray[np.intp], lam: Array) -> tuple[Array, Array]:
        """Return steps and disturbances under multipliers of some rows."""
        all_lam = np.zeros(len(self._at))
        all_lam[[self._at[row] for row in rows.tolist()]] = lam
        steps, w = self._free
        return steps + self._steps.dot(all_lam), w + self._w.dot(all_lam) if len(w) else w


def solve_multipliers(S: Array, right: Array) -> Array:
    """Solve S lam = right, with the least-squares solution where rows are dependent."""
    if not len(right):
        return right
    for jitter in (0.0, _JITTER * float(S.diagonal().max())):
        factor = eigenpy.LLT(S + jitter * np.eye(len(S)))
        if factor.info() == eigenpy.ComputationInfo.Success:
            lam = factor.solve(right).ravel()
            return np.asarray(lam + factor.solve(right - S.dot(lam)).ravel())
    return np.asarray(np.linalg.lstsq(S, right, rcond=None)[0])


def solve_active_set(
    bounds: WindowBounds, responses: Responses, sides: Sides
) -> tuple[Sides, Array]:
    """Return the active bounds at the optimum and their multipliers (sign-constrained NNLS).

    Each change adds the most violated bound of every kind. After many changes only the single most
    violated bound is added, for which the method is known to terminate.

    Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, ch. 23.

    Args:
        bounds: Bounds of the window.
        responses: Responses to multipliers.
        sides: Initial guess of the active bounds.

    Raises:
        SolveError: The active set does not settle.
    """
    lam = np.zeros(bounds.exist.size)
    while True:
        rows = np.flatnonzero(sides)
        target = responses.multipliers(rows, sides)
        wrong = (target * sides.ravel()[rows] <= 0.0) & ~bounds.are_equal[rows]
        if not wrong.any():
            break
        sides.flat[rows[wrong]] = 0
    lam[rows] = target
    for k in range(_CHANGES):
        rows = np.flatnonzero(sides)
        steps, w = responses.motion(rows, lam[rows])
        violated = np.where(sides == 0, bounds.find_violated(steps, w), 0).astype(np.int8)
        if not violated.any():
            return sides, lam[rows]
        sides = sides + bounds.worst(violated, steps, w, only_one=k >= _AT_ONCE)
        _drop_wrong_signs(bounds, responses, sides, lam)
    raise SolveError("the bounds of the window are infeasible: no motion satisfies all of them")


def _drop_wrong_signs(
    bounds: WindowBounds, responses: Responses, sides: Sides, lam: Array
) -> None:
    """Move multipliers towards their solution, and drop bounds whose sign would change."""
    while True:
        rows = np.flatnonzero(sides)
        target, signs = responses.multipliers(rows, sides), sides.ravel()[rows]
        wrong = (target * signs <= 0.0) & ~bounds.are_equal[rows]
        if not wrong.any():
            lam[rows] = target
            return
        shares = np.full(len(rows), np.inf)
        shares[wrong] = lam[rows[wrong]] / (lam[rows[wrong]] - target[wrong])
        lam[rows] += shares.min() * (target - lam[rows])
        dropped = rows[shares <= shares.min()]
        lam[dropped], sides.flat[dropped] = 0.0, 0


class WindowBounds:
    """Bounds of a window: one row for each node, of its state, then of the disturbance behind it.

    Args:
        nodes: Nodes of the window, either all with the same bounded quantities or none.
        lower: Lower bounds of the disturbances, shape (nw,).
        upper: Upper bounds of the disturbances, shape (nw,).

    Attributes:
        shape: Number of nodes, and number of bounds of each.
        exist: Which bounds exist and apply, of that shape.
        are_equal: Which bounds have equal lower and upper values, flat.
    """

    def __init__(self, nodes: Sequence[Node], lower: Array, upper: Array) -> None:
        self.lower_w = lower
        states = [node.bounds for node in nodes if node.bounds is not None]
        self._b = len(states[0].values) if len(states) == len(nodes) else 0
        self._which = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        count = len(nodes)
        self.shape = count, self._b + len(self._which)
        self._lower, self._upper = np.full((2, *self.shape), -np.inf)
        self._upper[:] = np.inf
        if self._b:
            self._state_values = np.array([state.values for state in states])
            self._slopes = [state.slope for state in states]
            self._lower[:, : self._b] = [state.lower for state in states]
            self._upper[:, : self._b] = [state.upper for state in states]
            self._can_be_released = states[0].can_be_released
        if len(self._which):
            self._lower[:-1, self._b :] = lower[self._which]
            self._upper[:-1, self._b :] = upper[self._which]
        self.exist = np.isfinite(self._lower) | np.isfinite(self._upper)
        self.are_equal = (self._lower >= self._upper).ravel()

    def values(self, steps: Array, w: Array) -> Array:
        """Return the bounded values, of the shape of the bounds."""
        values = np.zeros(self.shape)
        if self._b:
            slopes = self._slopes
            if all(slope is slopes[0] for slope in slopes):
                changes = steps.dot(slopes[0].T)
            else:
                changes = np.einsum("ibn,in->ib", np.array(slopes), steps)
            values[:, : self._b] = self._state_values + changes
        if len(self._which) and len(w):
            values[:-1, self._b :] = w[:, self._which]
        return values

    def find_violated(self, steps: Array, w: Array) -> Sides:
        """Return which bounds are violated, and on which side."""
        values = self.values(steps, w)
        slack = _TOLERANCE * (1.0 + np.abs(values))
        low, high = values < self._lower - slack, values > self._upper + slack
        sides: Sides = np.where(self.exist, low.astype(np.int8) - high.astype(np.int8), 0)
        return sides

    def exclude(self, released: set[int], free: tuple[Array, Array]) -> None:
        """Exclude released bounds from the window as long as they are violated.

        Args:
            released: Indices of the released bounds; those that hold again are removed from it.
            free: Steps and disturbances without active bounds.
        """
        if released:
            violated = self.find_violated(*free).any(axis=0)
            released &= set(np.flatnonzero(violated).tolist())
            self.exist[:, sorted(released)] = False

    def worst(self, violated: Sides, steps: Array, w: Array, *, only_one: bool) -> Sides:
        """Return, for each bound, the node with the largest violation, or only the largest one."""
        values = self.values(steps, w)
        excess = np.where(violated > 0, self._lower - values, values - self._upper)
        excess, sides = np.where(violated != 0, excess, -1.0), np.zeros_like(violated)
        columns = np.arange(excess.shape[1])
        nodes = excess.argmax(axis=0)
        if only_one:
            columns = columns[[int(excess[nodes, columns].argmax())]]
        at = nodes[columns], columns
        sides[at] = violated[at]
        return sides

    def release_contradicted(self, rows: NDArray[np.intp], misfit: Array) -> NDArray[np.intp]:
        """Exclude bounds that measurements clearly contradict, and return their indices.

        Args:
            rows: Active bounds, flat.
            misfit: Contribution of each to the squared, normalised misfit of the measurements.
        """
        if not self._b or self._can_be_released is None:
            return np.zeros(0, dtype=np.intp)
        total = np.bincount(rows % self.shape[1], misfit, minlength=self.shape[1])[: self._b]
        wrong = np.flatnonzero((total > _CERTAIN**2) & self._can_be_released)
        self.exist[:, wrong] = False
        return wrong

    def active_bounds(self, sides: Sides) -> Array:
        """Return the values of the active bounds, in their order."""
        chosen = sides != 0
        return np.where(sides > 0, self._lower, self._upper)[chosen]

    def unit_multipliers(self, rows: Sequence[int]) -> tuple[dict[int, Array], dict[int, Array]]:
        """Return unit multipliers by node: of states, (n, k), and of disturbances, (nw, k)."""
        h, nu = dict[int, Array](), dict[int, Array]()
        for k, row in enumerate(rows):
            i, j = divmod(row, self.shape[1])
            if j < self._b:
                n = self._slopes[i].shape[1]
                h.setdefault(i, np.zeros((n, len(rows))))[:, k] = self._slopes[i][j]
            else:
                block = nu.setdefault(i, np.zeros((len(self.lower_w), len(rows))))
                block[self._which[j - self._b], k] = 1.0
        return h, nu

    def changes(self, rows: NDArray[np.intp], steps: Array, w: Array) -> Array:
        """Return the changes of bounded values, shape (rows, k).

        Args:
            rows: Bounds, flat.
            steps: Changes of the steps, shape (count, n, k).
            w: Changes of the disturbances, shape (count - 1, nw, k).
        """
        nodes, at = np.divmod(rows, self.shape[1])
        changes = np.empty((len(rows), steps.shape[2]))
        states = at < self._b
        if states.any():
            pairs = zip(nodes[states].tolist(), at[states].tolist(), strict=True)
            slopes = np.array([self._slopes[i][j] for i, j in pairs])
            changes[states] = np.einsum("rn,rnk->rk", slopes, steps[nodes[states]])
        if not states.all():
            changes[~states] = w[nodes[~states], self._which[at[~states] - self._b]]
        return changes
