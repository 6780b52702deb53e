"""The nearest state on rows of any kind, such as loop closures."""

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.optimization.limit_forces import LimitForces, stops
from mbd_ros.core.optimization.move_qp import Metric, Move, MoveQp
from mbd_ros.core.projection.nearest_configuration import (
    NearestConfiguration,
    Rows,
    largest,
)
from mbd_ros.core.projection.nearest_state import Nearest
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import NEAREST, ON_MANIFOLD
from mbd_ros.errors import SolveError

_OPTIMAL = 1.0e-8  # accepted residual of the optimality condition, relative
_NAMED = 4  # violations in an error message


class NearestOnRows:
    """Successive quadratic programs for the configuration, one for the velocity.

    Args:
        system: All joints of a fixed-base robot.
        lower: Smallest positions [rad or m], shape (n,).
        upper: Largest positions [rad or m], shape (n,).
        of_position: Forces of the limits.
        of_velocity: Forces of those that are reached.

    Attributes:
        has_rates: Whether velocities have rows that positions do not have.
    """

    def __init__(
        self,
        system: System,
        lower: Array,
        upper: Array,
        of_position: LimitForces,
        of_velocity: LimitForces,
    ) -> None:
        self._system, self._lower, self._upper = system, lower, upper
        self._configuration = NearestConfiguration(system, lower, upper, of_position)
        self._program = MoveQp(system.nv, of_velocity)
        self._zero = np.zeros(system.nv)
        self.has_rates = len(system.held.rows) > len(system.rows)

    def rows(self, t: float, q: Array) -> Rows:
        """Residual g and Jacobian J, shapes (m,) and (m, n).

        Raises:
            SolveError: They are not finite.
        """
        return self._configuration.rows(t, q)

    def find(self, x: State, metric: Metric, of_velocity: Metric, rows: Rows) -> Nearest:
        """The nearest state.

        Args:
            x: The measurement, from which it starts.
            metric: W of positions.
            of_velocity: W of velocities.
            rows: What `rows` gives for x.

        Raises:
            SolveError: There is none near it, limits and rows contradict one another, or the
                answer does not pass the check.
        """
        found = self._configuration.find(x.t, x.q, metric, rows)
        if found is None:
            raise SolveError(self._too_far(x.q, rows[0]))
        q, move, at_q, iterations = found
        _check(q - x.q, metric, move, at_q)
        v = self._velocity(x, q, self.held(x.t, q, at_q[1]), of_velocity)
        return Nearest(q, v, move.lam, move.mu, iterations, move.condition)

    def held(self, t: float, q: Array, J: Array) -> Array:
        """Jacobian of all rows that velocities keep, from that of positions at the same q."""
        return self._system.held.jacobian(t, q) if self.has_rates else J

    def violation(self, x: State, rows: Rows | None = None) -> tuple[Array, Array]:
        """Residual g and its rate g' at any state, shapes (m,) and (m,).

        Args:
            x: The state.
            rows: What `rows` gives for it, where that is at hand.
        """
        g, J = rows or self.rows(x.t, x.q)
        return g, J.dot(x.v) + self._system.rate(x.t, x.q)

    def _velocity(self, x: State, q: Array, J: Array, metric: Metric) -> Array:
        rate = self._system.held.rate(x.t, q)
        floor, ceiling = stops(q, self._lower, self._upper)
        c = -(J.dot(x.v) + rate)
        try:
            p = self._program.solve(metric, self._zero, J, c, floor - x.v, ceiling - x.v).p
        except SolveError as error:
            reached = np.isfinite(floor) | np.isfinite(ceiling)
            names = ", ".join(j.name for j in self._system.robot.joints if reached[j.v])
            at = f" at the limits of {names}" if names else ""
            raise SolveError(f"no consistent velocity{at}: {error}") from error
        v = np.minimum(np.maximum(x.v + p, floor), ceiling)
        left = largest(J.dot(v) + rate)
        if not left <= ON_MANIFOLD * (1.0 + largest(x.v)):
            raise SolveError(f"no consistent velocity: the rows keep a rate of {left:.1e} 1/s")
        return v

    def _too_far(self, q: Array, g: Array) -> str:
        """Message for a measurement without a state near it."""
        beyond = q - np.minimum(np.maximum(q, self._lower), self._upper)
        off = [(row.name, g[i]) for i, row in enumerate(self._system.rows)]
        off += [(f"limit of {joint.name}", beyond[joint.v]) for joint in self._system.robot.joints]
        off.sort(key=lambda item: -abs(item[1]))
        worst = ", ".join(f"{name} by {distance:.3g}" for name, distance in off[:_NAMED])
        return f"no consistent state near the measured one, which violates {worst} (rad or m)"


def _check(p: Array, metric: Metric, move: Move, rows: Rows) -> None:
    """Raise unless a solution is on the manifold and the nearest there."""
    g, J = rows
    if not largest(g) <= ON_MANIFOLD:
        raise SolveError(f"the projected state is {largest(g):.1e} rad or m off its constraints")
    pull = metric.W.dot(p)
    left = largest(pull - J.T.dot(move.lam) - move.mu)
    if not left <= _OPTIMAL * largest(pull) + NEAREST * largest(metric.W):
        raise SolveError(f"the projected state is not the nearest one: residual {left:.1e}")
