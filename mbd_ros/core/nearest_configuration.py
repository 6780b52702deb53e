"""The configuration nearest to a measured one, on the constraints and within limits.

    min 1/2 p' W p,  p = q - q_m   subject to  g(t, q) = 0,  lower <= q <= upper

by successive quadratic programs, each with the rows of the last configuration. Source: J. Nocedal
and S. Wright, Numerical Optimization, 2006, ch. 18.
"""

import math

import numpy as np

from mbd_ros.core.nearest_point import Metric, Move, NearestPoint, is_convex, row_weight
from mbd_ros.core.state import Array, State
from mbd_ros.core.system import System
from mbd_ros.errors import SolveError

_QUICK, _PATIENT = 30, 60  # quadratic programs of either way
_NEAREST = 1.0e-11  # step that no longer brings the configuration nearer [rad or m]
_ACCURATE = 1.0e-9  # step after which nothing of second order in it counts
_STEP = 0.5  # largest step of one joint in one iteration [rad or m], so that the branch is kept
_SLOW = 0.1  # step over the last one from which second derivatives of the rows pay
_STIFF = 1.0e3  # of the rows beside second derivatives that are convex along them only
_HALF = 1.0e-5  # of the step of their difference quotients [rad or m]
_SMALLEST_SHARE = 1.0e-6
_LANDED = 1.0e-13  # |g| [rad or m]
_ON_MANIFOLD = 1.0e-12  # the same, accepted
_LANDING = 50  # Newton steps
_OPTIMAL = 1.0e-8  # accepted residual of the optimality condition, relative
_ROUNDING = 1.0e-14
Rows = tuple[Array, Array]  # g and J


class NearestConfiguration:
    """Full steps first; where they do not converge, downhill along the manifold.

    Args:
        system: All joints of a fixed-base robot.
        lower: Smallest positions [rad or m], shape (nv,).
        upper: Largest positions [rad or m], shape (nv,).

    Attributes:
        program: The quadratic program, with its statistics.
    """

    def __init__(self, system: System, lower: Array, upper: Array) -> None:
        self._system, self._lower, self._upper = system, lower, upper
        bounded = bool(np.isfinite(lower).any() or np.isfinite(upper).any())
        self.program = NearestPoint(system.nv, bounded)
        self._zero = np.zeros(system.nv)

    def rows(self, t: float, q: Array) -> Rows:
        """Residual g and Jacobian J, shapes (m,) and (m, nv).

        Raises:
            SolveError: They are not finite.
        """
        system, x = self._system, State(t, q, self._zero)
        rows, data = system.constraints, system.data
        if rows.reads_frames:
            system.refresh(q, self._zero)
        g, J = rows.residual(data, x), rows.jacobian(data, x)
        if not math.isfinite(g.sum() + J.sum()):
            raise SolveError("the constraint rows are not finite at the measured state")
        return g, J

    def find(
        self, t: float, measured: Array, metric: Metric, rows: Rows
    ) -> tuple[Array, Move, Array, int]:
        """The nearest configuration.

        Args:
            t: Time [s].
            measured: q_m, and where to start from, shape (nv,).
            metric: W.
            rows: What `rows` gives for q_m.

        Returns:
            q, its multipliers, J at q, and the number of quadratic programs.

        Raises:
            SolveError: There is none near it, limits and rows contradict one another, or the
                answer does not pass the check.
        """
        found = self._full_steps(t, measured, metric, rows) or self._downhill(t, measured, metric)
        if found is None:
            gap = float(np.abs(rows[0]).max(initial=0.0))
            raise SolveError(
                f"no consistent state near the measured one, which is {gap:.3g} rad or m off its "
                "constraints"
            )
        move, iterations = found
        q = np.minimum(np.maximum(measured + move.p, self._lower), self._upper)
        return q, move, self._checked(t, measured, q, metric, move), iterations

    def _full_steps(
        self, t: float, measured: Array, metric: Metric, rows: Rows
    ) -> tuple[Move, int] | None:
        q, last, H = measured, np.inf, metric
        for iteration in range(1, _QUICK + 1):
            move = self._towards(q, measured, metric, H, rows)
            largest = float(np.abs(move.p).max(initial=0.0))
            ahead = largest * min(1.0, largest / last)  # the next step
            if ahead <= _NEAREST and largest <= _ACCURATE:
                return move._replace(p=q + move.p - measured), iteration
            q = q + move.p * min(1.0, _STEP / largest)
            rows = self.rows(t, q)
            H = metric if largest < _SLOW * last else self._curved(t, q, move.lam, metric)
            last = largest
        return None

    def _downhill(self, t: float, measured: Array, metric: Metric) -> tuple[Move, int] | None:
        """Every iterate on the manifold and nearer than the last one."""
        q, share, H = self._landed(t, measured, metric), 1.0, metric
        if q is None:
            return None
        for iteration in range(_QUICK + 1, _QUICK + _PATIENT + 1):
            move = self._towards(q, measured, metric, H, self.rows(t, q))
            largest = float(np.abs(move.p).max(initial=0.0))
            if largest <= _NEAREST:
                return move._replace(p=q + move.p - measured), iteration
            away = q - measured
            least = (1.0 + _ROUNDING) * away.dot(metric.W.dot(away))
            while share > _SMALLEST_SHARE:
                there = self._landed(t, q + move.p * min(share, _STEP / largest), metric)
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

    def _towards(self, q: Array, measured: Array, metric: Metric, H: Metric, rows: Rows) -> Move:
        """The step from q, with H for the second derivatives."""
        g, J = rows
        pull = metric.W.dot(q - measured)
        return self.program.solve(H, pull, J, -g, self._lower - q, self._upper - q)

    def _curved(self, t: float, q: Array, lam: Array, metric: Metric) -> Metric:
        """W less what the rows curve, where that is still convex along them; else W."""
        n = len(q)
        H, half = metric.W.copy(), np.zeros(n)
        for i in range(n):
            half[i] = _HALF
            turned = self.rows(t, q + half)[1] - self.rows(t, q - half)[1]
            H[:, i] -= turned.T.dot(lam) / (2.0 * _HALF)
            half[i] = 0.0
        H = 0.5 * (H + H.T)
        _, J = self.rows(t, q)
        weight = _STIFF * row_weight(self._system.mass(q), J)
        curved = Metric(H, weight, metric.undetermined)
        return curved if is_convex(curved, J) else metric

    def _landed(self, t: float, q: Array, metric: Metric) -> Array | None:
        """Newton's method on g with the shortest steps; None if it does not close."""
        for _ in range(_LANDING):
            g, J = self.rows(t, q)
            if float(np.abs(g).max(initial=0.0)) <= _LANDED:
                return q
            limits = self._lower - q, self._upper - q
            p = self.program.solve(metric, self._zero, J, -g, *limits).p
            largest = float(np.abs(p).max(initial=0.0))
            if not largest > _LANDED:
                break
            q = q + p * min(1.0, _STEP / largest)
        g, _ = self.rows(t, q)
        return q if float(np.abs(g).max(initial=0.0)) <= _ON_MANIFOLD else None

    def _checked(self, t: float, measured: Array, q: Array, metric: Metric, move: Move) -> Array:
        """J at an answer that is on the manifold and the nearest there."""
        g, J = self.rows(t, q)
        gap = float(np.abs(g).max(initial=0.0))
        if not gap <= _ON_MANIFOLD:
            raise SolveError(f"the projected state is {gap:.1e} rad or m off its constraints")
        pull = metric.W.dot(q - measured)
        left = float(np.abs(pull - J.T.dot(move.lam) - move.mu).max(initial=0.0))
        size = _OPTIMAL * float(np.abs(pull).max(initial=0.0))
        if not left <= size + _NEAREST * float(np.abs(metric.W).max(initial=0.0)):
            raise SolveError(f"the projected state is not the nearest one: residual {left:.1e}")
        return J
