"""The window of a moving horizon as a chain: forward by covariances, back by costates.

For d_i+1 = F d_i + gap + G w_i, a prior of d_0 and white measurements r_i = H_i d_i the optimum is

    e = r - H m,   m+ = m + K e + P+ h,   m_i+1 = F m+ + gap + G Q nu               (forward)
    d = m+ - P+ lam,   p = lam - h,   lam- = p - H' (S^-1 e + K' p),   lam_i-1 = F' lam-  (back)
    w = Q (nu - G' lam-)

h and nu are multipliers of bounds on d and w. A new sample changes means; covariances change only
behind a node that was linearised again. Sources: H. E. Rauch, F. Tung, C. T. Striebel,
AIAA J. 3(8) (1965); A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, sec. 13.2, on costates.
"""

from collections.abc import Sequence

import eigenpy
import numpy as np

from mbd_ros.core.estimation.horizon_nodes import Answer, Arrival, Link, Node, Whitening
from mbd_ros.core.estimation.horizon_sweep import Responses, exchanged, sweep
from mbd_ros.core.estimation.process import Process, Transition
from mbd_ros.core.estimation.window_bounds import Sides, WindowBounds
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError


class HorizonChain:
    """Solves the windows of a horizon with a prior.

    Args:
        process: The process.
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
