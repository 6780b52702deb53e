"""The configuration nearest to a measured one, on the constraints and within limits.

    min 1/2 p' W p,  p = q - q_m   subject to  g(t, q) = 0,  lower <= q <= upper

by successive quadratic programs, each with the rows of the last configuration. Source: J. Nocedal
and S. Wright, Numerical Optimization, 2006, ch. 18.
"""

import math

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.optimization.limit_forces import LimitForces
from mbd_ros.core.optimization.move_qp import Metric, Move, MoveQp, is_convex, row_weight
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import BRANCH_STEP, LANDED, NEAREST, ON_MANIFOLD
from mbd_ros.errors import SolveError

_QUICK, _PATIENT = 30, 60  # quadratic programs of either way
_ACCURATE = 1.0e-9  # step after which nothing of second order in it counts
_SLOW = 0.1  # step over the last one from which second derivatives of the rows pay
_STIFF = 1.0e3  # of the rows beside second derivatives that are convex along them only
_HALF = 1.0e-5  # of the step of their difference quotients [rad or m]
_SMALLEST_SHARE = 1.0e-6
_LANDING = 50  # Newton steps
_ROUNDING = 1.0e-14
Rows = tuple[Array, Array]  # g and J


class NearestConfiguration:
    """Full steps first; where they do not converge, downhill along the manifold.

    The caller checks the result.

    Args:
        system: All joints of a fixed-base robot.
        lower: Smallest positions [rad or m], shape (nv,).
        upper: Largest positions [rad or m], shape (nv,).
        limits: Their forces.
    """

    def __init__(self, system: System, lower: Array, upper: Array, limits: LimitForces) -> None:
        self._system, self._lower, self._upper = system, lower, upper
        self._program = MoveQp(system.nv, limits)
        self._zero, self._far = np.zeros(system.nv), np.full(system.nv, np.inf)

    def rows(self, t: float, q: Array) -> Rows:
        """Residual g and Jacobian J, shapes (m,) and (m, nv).

        Raises:
            SolveError: They are not finite.
        """
        system, x = self._system, State(t, q, self._zero)
        rows, k = system.constraints, system.k
        k.refresh(q, self._zero, min(rows.reads, Reads.JACOBIAN))
        g, J = rows.residual(k, x), rows.jacobian(k, x)
        if not math.isfinite(g.sum() + J.sum()):
            raise SolveError("the constraint rows are not finite at the measured state")
        return g, J

    def find(
        self, t: float, measured: Array, metric: Metric, rows: Rows
    ) -> tuple[Array, Move, Rows, int] | None:
        """The nearest configuration.

        Args:
            t: Time [s].
            measured: q_m; where it is beyond limits, the search begins at them, shape (nv,).
            metric: W.
            rows: What `rows` gives for q_m.

        Returns:
            q, its multipliers, g and J at q, and the number of quadratic programs; None where
            none is found.

        Raises:
            SolveError: Rows or masses are not finite on the way.
        """
        start = self._clipped(measured)
        if (start != measured).any():
            rows = self.rows(t, start)
        found = self._full_steps(t, measured, start, metric, rows)
        found = found or self._downhill(t, measured, start, metric)
        if found is None:
            return None
        move, iterations = found
        q = self._clipped(measured + move.p)
        rows = self.rows(t, q)
        if largest(rows[0]) > ON_MANIFOLD:  # limits are kept relative to what pulls at them
            landed = self._landed(t, q, metric)
            q = q if landed is None else self._clipped(landed)
            rows = self.rows(t, q)
        return q, move, rows, iterations

    def _full_steps(
        self, t: float, measured: Array, q: Array, metric: Metric, rows: Rows
    ) -> tuple[Move, int] | None:
        last, H = np.inf, metric
        for iteration in range(1, _QUICK + 1):
            move = self._towards(q, metric.W.dot(q - measured), H, rows)
            if move is None:
                return None
            length = largest(move.p)
            ahead = length * min(1.0, length / last)  # the next step
            if ahead <= NEAREST and length <= _ACCURATE:
                return move._replace(p=q + move.p - measured), iteration
            q = q + move.p * min(1.0, BRANCH_STEP / length)
            rows = self.rows(t, q)
            H = metric if length < _SLOW * last else self._curved(t, q, move.lam, metric)
            last = length
        return None

    def _downhill(
        self, t: float, measured: Array, start: Array, metric: Metric
    ) -> tuple[Move, int] | None:
        """Every iterate on the manifold and nearer than the last one."""
        landed, share, H = self._landed(t, start, metric), 1.0, metric
        if landed is None:
            return None
        q = landed
        for iteration in range(_QUICK + 1, _QUICK + _PATIENT + 1):
            away = q - measured
            move = self._towards(q, metric.W.dot(away), H, self.rows(t, q))
            if move is None:
                return None
            length = largest(move.p)
            if length <= NEAREST:
                return move._replace(p=q + move.p - measured), iteration
            least = (1.0 + _ROUNDING) * away.dot(metric.W.dot(away))
            while share > _SMALLEST_SHARE:
                there = self._landed(t, q + move.p * min(share, BRANCH_STEP / length), metric)
                if there is not None:
                    away = there - measured
                    if away.dot(metric.W.dot(away)) <= least:
                        q = there
                        break
                share *= 0.5
            else:
                return None
            H = self._curved(t, q, move.lam, metric)
        return None

    def _towards(self, q: Array, pull: Array, H: Metric, rows: Rows) -> Move | None:
        """The step from q, with H for the second derivatives; None where limits forbid any."""
        g, J = rows
        try:
            return self._program.solve(H, pull, J, -g, self._lower - q, self._upper - q)
        except SolveError:
            return None

    def _curved(self, t: float, q: Array, lam: Array, metric: Metric) -> Metric:
        """W less the curvature of the rows, where that is still convex along them; else W."""
        n = len(q)
        H, half = metric.W.copy(), np.zeros(n)
        for i in range(n):
            half[i] = _HALF
            turned = self.rows(t, q + half)[1] - self.rows(t, q - half)[1]
            H[:, i] -= turned.T.dot(lam) / (2.0 * _HALF)
            half[i] = 0.0
        H = 0.5 * (H + H.T)
        _, J = self.rows(t, q)
        weight = _STIFF * row_weight(self._system.mass(q).dense, J)
        curved = Metric(H, weight)
        return curved if is_convex(curved, J) else metric

    def _landed(self, t: float, q: Array, metric: Metric) -> Array | None:
        """Newton's method on g with the shortest steps; None if it does not close."""
        for _ in range(_LANDING):
            g, J = self.rows(t, q)
            if largest(g) <= LANDED:
                return q
            move = self._towards(q, self._zero, metric, (g, J))
            if move is None:  # a later linearisation may know a way back
                move = self._program.solve(metric, self._zero, J, -g, -self._far, self._far)
            length = largest(move.p)
            if not length > LANDED:
                break
            q = q + move.p * min(1.0, BRANCH_STEP / length)
        g, _ = self.rows(t, q)
        return q if largest(g) <= ON_MANIFOLD else None

    def _clipped(self, q: Array) -> Array:
        return np.minimum(np.maximum(q, self._lower), self._upper)


def largest(values: Array) -> float:
    """Largest absolute value, 0 of none."""
    return float(np.abs(values).max(initial=0.0))
