"""The window of a moving horizon: its nodes, and their program.

    min |x_s (-) xbar|^2_{P^-1} + sum |w_k|^2_{Q^-1} + sum |y_k - h(x_k)|^2_{R^-1}
    subject to x_k+1 = f(x_k, u_k) (+) G w_k,  bounds of x_k and of w_k

Gauss and Newton's method over several shoots: nodes are linearised where they stand, gaps between
them close with the step. What is searched, xi, is white: x_s by the factor of P, w by that of Q.
Sources: C. V. Rao, J. B. Rawlings, D. Q. Mayne, IEEE Trans. Autom. Control 48(2) (2003);
H. G. Bock, multiple shooting, 1983; M. Diehl et al., in Assessment and Future Directions of
Nonlinear MPC, 2007, on one iteration a sample.
"""

from typing import NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.optimization.hard_soft_qp import Optimum, RowBoundedQp
from mbd_ros.core.state import NONE as _NONE
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.methods.estimation.horizon_chain import Answer, Arrival, Node, Whitening
from mbd_ros.methods.estimation.process import Process, Transition

_FLOOR = 1.0e-15  # eigenvalues of a covariance below that share of the largest are none


class Rows(NamedTuple):
    """lower <= C xi <= upper, for as many xi as C has columns."""

    C: Array
    lower: Array
    upper: Array


class HorizonProgram:
    """Builds and solves the quadratic program of a window.

    Args:
        lower: Smallest disturbances, shape (nw,).
        upper: Largest disturbances, shape (nw,).
    """

    def __init__(self, process: Process, lower: Array, upper: Array) -> None:
        self._process, self._lower, self._upper = process, lower, upper
        self._is_bounded = np.isfinite(lower) | np.isfinite(upper)
        self._qp = RowBoundedQp()
        self._whitening = Whitening()

    def solve(self, nodes: list[Node], arrival: Arrival) -> Answer:
        """Steps of all nodes.

        Raises:
            SolveError: Bounds contradict one another, or nothing determines the window.
        """
        n, roots = self._process.n, [self._root(node.going) for node in nodes[:-1]]
        ends = [n, *(n + np.cumsum([L.shape[1] for L in roots])).tolist()]
        width = ends[-1]
        H, g = np.eye(width), np.zeros(width)
        S, e = self._first(nodes[0], arrival)
        if arrival.P is None:
            H[:n, :n] = 0.0
        paths = [(S, e)]
        for i, node in enumerate(nodes):
            self._measure(node, S, e, H, g)
            if i < len(roots):
                S, e = self._onward(node, nodes[i + 1], S, e, roots[i])
                paths.append((S, e))
        factor = eigenpy.LLT(H)
        if factor.info() != eigenpy.ComputationInfo.Success:
            raise SolveError("what was measured does not determine the window")
        found = Optimum(-factor.solve(g).ravel(), _NONE, 0.0)
        steps, w = _motion(found.x, paths, roots, ends)
        if not self._are_kept(nodes, steps, w):
            rows = self._all_rows(nodes, paths, roots, ends)
            found = self._qp.solve(H, g, *_stacked(rows, width))
            steps, w = _motion(found.x, paths, roots, ends)
        P = S.dot(factor.solve(S.T).reshape(width, n))
        active = int(np.count_nonzero(found.multipliers))
        return Answer(steps, 0.5 * (P + P.T), found.residual, active, w)

    def _are_kept(self, nodes: list[Node], steps: Array, w: Array) -> bool:
        """Whether no bound of states and disturbances is passed."""
        for node, step in zip(nodes, steps, strict=True):
            bounds = node.bounded
            if bounds is not None and len(bounds.values):
                there = bounds.values + bounds.by.dot(step)
                if (there < bounds.lower).any() or (there > bounds.upper).any():
                    return False
        which = self._is_bounded
        pushed = w[:, which] if len(w) else w
        return not ((pushed < self._lower[which]).any() or (pushed > self._upper[which]).any())

    def _all_rows(
        self,
        nodes: list[Node],
        paths: list[tuple[Array, Array]],
        roots: list[Array],
        ends: list[int],
    ) -> list[Rows]:
        rows = list[Rows]()
        for i, (node, (S, e)) in enumerate(zip(nodes, paths, strict=True)):
            self._bound_state(node, S, e, rows)
            if i < len(roots):
                self._bound_noise(roots[i], ends[i], rows)
        return rows

    def _root(self, going: Transition | None) -> Array:
        assert going is not None
        return root(going.Q)

    def _first(self, node: Node, arrival: Arrival) -> tuple[Array, Array]:
        if arrival.P is None:
            return np.eye(self._process.n), np.zeros(self._process.n)
        return root(arrival.P), -self._process.minus(node.x, arrival.x)

    def _measure(self, node: Node, S: Array, e: Array, H: Array, g: Array) -> None:
        """Add |y - h|^2 of a node, whose step is e + S xi."""
        assert node.seen is not None
        told, (y, slope, R) = np.isfinite(node.values), node.seen
        if not told.any():
            return
        whiten = self._whitening.of(R, told)
        slope = whiten.dot(slope[told])
        error = whiten.dot(node.values[told] - y[told]) - slope.dot(e)
        rows, at = slope.dot(S), S.shape[1]
        H[:at, :at] += rows.T.dot(rows)
        g[:at] -= rows.T.dot(error)

    def _onward(
        self, node: Node, following: Node, S: Array, e: Array, L: Array
    ) -> tuple[Array, Array]:
        """Step of the next node: its matrix and offset."""
        going, process = node.going, self._process
        assert going is not None
        after = np.hstack((going.F.dot(S), going.G.dot(L)))
        gap, moved = process.minus(going.x, following.x), going.F.dot(e)
        turn = process.turned(going.x, following.x)
        if turn is None:
            return after, moved + gap
        return turn.dot(after), turn.dot(moved) + gap

    @staticmethod
    def _bound_state(node: Node, S: Array, e: Array, rows: list[Rows]) -> None:
        bounds = node.bounded
        if bounds is not None and len(bounds.values):
            here = bounds.values + bounds.by.dot(e)
            rows.append(Rows(bounds.by.dot(S), bounds.lower - here, bounds.upper - here))

    def _bound_noise(self, L: Array, at: int, rows: list[Rows]) -> None:
        which = self._is_bounded
        if which.any():
            C = np.zeros((int(which.sum()), at + L.shape[1]))
            C[:, at:] = L[which]
            rows.append(Rows(C, self._lower[which], self._upper[which]))


def _motion(
    xi: Array, paths: list[tuple[Array, Array]], roots: list[Array], ends: list[int]
) -> tuple[Array, Array]:
    """Steps of the nodes, and disturbances between them."""
    steps = np.array([e + S.dot(xi[: S.shape[1]]) for S, e in paths])
    w = [L.dot(xi[at : at + L.shape[1]]) for L, at in zip(roots, ends, strict=False)]
    return steps, np.array(w)


def _stacked(rows: list[Rows], width: int) -> Rows:
    C = np.zeros((sum(len(block.C) for block in rows), width))
    at = 0
    for block in rows:
        C[at : at + len(block.C), : block.C.shape[1]] = block.C
        at += len(block.C)
    none = np.zeros(0)
    lower = np.concatenate([none, *(block.lower for block in rows)])
    return Rows(C, lower, np.concatenate([none, *(block.upper for block in rows)]))


def root(P: Array) -> Array:
    """L with L L' = P, as many columns as rows; directions without variance are 0."""
    factor = eigenpy.LLT(P)
    if factor.info() == eigenpy.ComputationInfo.Success:
        lower: Array = factor.matrixL()
        return np.array(lower).reshape(P.shape)
    values, vectors = np.linalg.eigh(P)
    kept = np.maximum(values, 0.0)
    kept[values < _FLOOR * values.max(initial=0.0)] = 0.0
    return np.asarray(vectors * np.sqrt(kept))
