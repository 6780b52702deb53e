"""Moving-horizon estimation: the quadratic program of a window of nodes.

    min |x_s (-) xbar|^2_{P^-1} + sum |w_k|^2_{Q^-1} + sum |y_k - h(x_k)|^2_{R^-1}
    subject to x_k+1 = f(x_k, u_k) (+) G w_k,  bounds of x_k and of w_k

The program is solved by multiple shooting with Gauss-Newton steps: each node is linearised at its
own state, and a step closes the gaps between nodes. The unknowns xi have unit covariance: x_s is
scaled by the factor of P, w by that of Q.
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
from mbd_ros.methods.estimation.horizon_chain import Arrival, Node, Whitening, WindowSolution
from mbd_ros.methods.estimation.process import Process, Transition

_FLOOR = 1.0e-15  # eigenvalues of a covariance below this share of the largest count as 0


class Rows(NamedTuple):
    """Bounds lower <= C xi <= upper on the first entries of xi, as many as C has columns."""

    C: Array
    lower: Array
    upper: Array


class HorizonProgram:
    """Builds and solves the quadratic program of a window.

    Args:
        lower: Lower bounds of the disturbances, shape (nw,).
        upper: Upper bounds of the disturbances, shape (nw,).
    """

    def __init__(self, process: Process, lower: Array, upper: Array) -> None:
        self._process = process
        self._lower = lower
        self._upper = upper
        self._is_bounded = np.isfinite(lower) | np.isfinite(upper)
        self._qp = RowBoundedQp()
        self._whitening = Whitening()

    def solve(self, nodes: list[Node], arrival: Arrival) -> WindowSolution:
        """Solve for the steps of all nodes.

        Raises:
            SolveError: The bounds are infeasible, or the measurements do not determine the states.
        """
        n, roots = self._process.n, [self._root(node.transition) for node in nodes[:-1]]
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
            raise SolveError(
                "the measurements of the window do not determine its states; add a sensor or prior"
            )
        optimum = Optimum(-factor.solve(g).ravel(), _NONE, 0.0)
        steps, w = _motion(optimum.x, paths, roots, ends)
        if not self._is_feasible(nodes, steps, w):
            rows = self._all_rows(nodes, paths, roots, ends)
            optimum = self._qp.solve(H, g, *_stack(rows, width))
            steps, w = _motion(optimum.x, paths, roots, ends)
        P = S.dot(factor.solve(S.T).reshape(width, n))
        active = int(np.count_nonzero(optimum.multipliers))
        return WindowSolution(steps, 0.5 * (P + P.T), optimum.residual, active, w)

    def _is_feasible(self, nodes: list[Node], steps: Array, w: Array) -> bool:
        """Return whether all bounds of states and disturbances hold."""
        for node, step in zip(nodes, steps, strict=True):
            bounds = node.bounds
            if bounds is not None and len(bounds.values):
                values = bounds.values + bounds.slope.dot(step)
                if (values < bounds.lower).any() or (values > bounds.upper).any():
                    return False
        which = self._is_bounded
        bounded = w[:, which] if len(w) else w
        return not ((bounded < self._lower[which]).any() or (bounded > self._upper[which]).any())

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

    def _root(self, transition: Transition | None) -> Array:
        assert transition is not None
        return square_root(transition.Q)

    def _first(self, node: Node, arrival: Arrival) -> tuple[Array, Array]:
        if arrival.P is None:
            return np.eye(self._process.n), np.zeros(self._process.n)
        return square_root(arrival.P), -self._process.minus(node.x, arrival.x)

    def _measure(self, node: Node, S: Array, e: Array, H: Array, g: Array) -> None:
        """Add |y - h|^2 of a node, whose step is e + S xi, to the cost."""
        assert node.observation is not None
        measured, (y, slope, R) = np.isfinite(node.values), node.observation
        if not measured.any():
            return
        whiten = self._whitening.matrix(R, measured)
        slope = whiten.dot(slope[measured])
        error = whiten.dot(node.values[measured] - y[measured]) - slope.dot(e)
        rows, at = slope.dot(S), S.shape[1]
        H[:at, :at] += rows.T.dot(rows)
        g[:at] -= rows.T.dot(error)

    def _onward(
        self, node: Node, following: Node, S: Array, e: Array, L: Array
    ) -> tuple[Array, Array]:
        """Return matrix and offset of the step of the next node."""
        transition, process = node.transition, self._process
        assert transition is not None
        matrix = np.hstack((transition.F.dot(S), transition.G.dot(L)))
        gap, offset = process.minus(transition.x, following.x), transition.F.dot(e)
        T = process.transport(transition.x, following.x)
        if T is None:
            return matrix, offset + gap
        return T.dot(matrix), T.dot(offset) + gap

    @staticmethod
    def _bound_state(node: Node, S: Array, e: Array, rows: list[Rows]) -> None:
        bounds = node.bounds
        if bounds is not None and len(bounds.values):
            values = bounds.values + bounds.slope.dot(e)
            rows.append(Rows(bounds.slope.dot(S), bounds.lower - values, bounds.upper - values))

    def _bound_noise(self, L: Array, at: int, rows: list[Rows]) -> None:
        which = self._is_bounded
        if which.any():
            C = np.zeros((int(which.sum()), at + L.shape[1]))
            C[:, at:] = L[which]
            rows.append(Rows(C, self._lower[which], self._upper[which]))


def _motion(
    xi: Array, paths: list[tuple[Array, Array]], roots: list[Array], ends: list[int]
) -> tuple[Array, Array]:
    """Return the steps of the nodes and the disturbances between them."""
    steps = np.array([e + S.dot(xi[: S.shape[1]]) for S, e in paths])
    w = [L.dot(xi[at : at + L.shape[1]]) for L, at in zip(roots, ends, strict=False)]
    return steps, np.array(w)


def _stack(rows: list[Rows], width: int) -> Rows:
    C = np.zeros((sum(len(block.C) for block in rows), width))
    at = 0
    for block in rows:
        C[at : at + len(block.C), : block.C.shape[1]] = block.C
        at += len(block.C)
    none = np.zeros(0)
    lower = np.concatenate([none, *(block.lower for block in rows)])
    return Rows(C, lower, np.concatenate([none, *(block.upper for block in rows)]))


def square_root(P: Array) -> Array:
    """Return a square matrix L with L L' = P; directions without variance are 0."""
    factor = eigenpy.LLT(P)
    if factor.info() == eigenpy.ComputationInfo.Success:
        lower: Array = factor.matrixL()
        return np.array(lower).reshape(P.shape)
    values, vectors = np.linalg.eigh(P)
    values[values < _FLOOR * values.max(initial=0.0)] = 0.0
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
