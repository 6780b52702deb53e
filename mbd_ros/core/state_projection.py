"""The state nearest to a measured one, on the constraints and within the joint limits.

    position   min 1/2 p' W p,  p = q - q_m   subject to  g(t, q) = 0,  lower <= q <= upper
    velocity   min 1/2 p' W p,  p = v - v_m   subject to  J v + dg/dt = 0, and no motion out of a
                                                          limit that is reached

W is the mass matrix at the measured state, `nearest_point.metric_of` says what it is for joints
that were not measured. Source: E. Eich, SIAM J. Numer. Anal. 30 (1993).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.nearest_configuration import NearestConfiguration, Rows
from mbd_ros.core.nearest_point import Metric, NearestPoint, metric_of
from mbd_ros.core.qp import Statistics
from mbd_ros.core.state import Array, State
from mbd_ros.core.system import System
from mbd_ros.errors import ModelError, SolveError

_CONSISTENT = 1.0e-12  # accepted |g'| per unit of velocity
_REACHED = 1.0e-9  # distance from a limit that counts as reached [rad or m]


class Measurement(NamedTuple):
    """A state of all joints of which some entries were measured.

    Attributes:
        x: The state; an entry that was not measured says where to start from.
        known: Joints whose position was measured, shape (nv,).
        known_velocity: Joints whose velocity was measured, shape (nv,).
    """

    x: State
    known: NDArray[np.bool_]
    known_velocity: NDArray[np.bool_]


class Prepared(NamedTuple):
    """What a projection begins with: rows and metric at the measurement."""

    rows: Rows
    metric: Metric


class Projection(NamedTuple):
    """The nearest consistent state, and how far the measurement was from it.

    The multipliers are no forces of the mechanism: W (q - q_m) = J' multipliers + limit
    multipliers. They say which row had to push how hard to bring the measurement where it is.

    Attributes:
        x: The state.
        multipliers: Of the rows, unit of the row's force times s^2, shape (m,).
        limit_multipliers: Of the limits, positive at a lower one, shape (nv,).
        gap: g of the measurement, joints that it lacks taken from x [rad or m], shape (m,).
        rate: g' likewise [1/s], shape (m,).
        excess: How far it is beyond a limit, negative below a lower one, shape (nv,).
        undetermined: Joints that neither measurement nor rows place: they stay, shape (nv,).
        iterations: Quadratic programs that the position took.
        condition: Condition number of the rows in the metric.
    """

    x: State
    multipliers: Array
    limit_multipliers: Array
    gap: Array
    rate: Array
    excess: Array
    undetermined: NDArray[np.bool_]
    iterations: int
    condition: float


class StateProjector:
    """Finds the nearest consistent state; every answer is checked.

    Args:
        system: All joints of a fixed-base robot, the rows to keep as its `rows`.
        limits: Whether the position limits of the joints are kept.
        amplification: Errors of measured joints may be so much larger in a reconstructed one.

    Attributes:
        lower: Smallest position of each joint, shape (nv,).
        upper: Largest position of each joint, shape (nv,).

    Raises:
        ModelError: The base floats, or the system integrates other coordinates than all joints.
    """

    def __init__(
        self, system: System, *, limits: bool = True, amplification: float = 20.0
    ) -> None:
        joints, n = system.robot.joints, system.nv
        if system.robot.floating:
            raise ModelError(
                "joint states do not carry the pose of a floating base; use base: fixed"
            )
        if n != system.model.nv:
            raise ModelError(f"tier {system.tier} eliminates joints: tier kkt keeps all")
        self.system, self._amplification = system, amplification
        self.lower, self.upper = np.full(n, -np.inf), np.full(n, np.inf)
        for joint in joints if limits else ():
            self.lower[joint.v], self.upper[joint.v] = joint.lower, joint.upper
        self._position = NearestConfiguration(system, self.lower, self.upper)
        self._zero = np.zeros(n)
        self._velocity = NearestPoint(n, bool(np.isfinite([self.lower, self.upper]).any()))

    @property
    def statistics(self) -> tuple[int, Statistics]:
        """How often a limit acted, and how the QPs for that went."""
        parts = self._position.program, self._velocity
        counts = zip(*(part.statistics for part in parts), strict=True)
        return sum(p.bounded_solves for p in parts), Statistics(*(sum(c) for c in counts))

    def prepare(self, m: Measurement) -> Prepared:
        """Rows and metric at a measurement, with the joints that nothing determines.

        Raises:
            SolveError: The rows are not finite there.
        """
        rows = self._position.rows(m.x.t, m.x.q)
        M = self.system.mass(m.x.q)
        return Prepared(rows, metric_of(M, rows[1], m.known, self._amplification))

    def project(self, m: Measurement, prepared: Prepared | None = None) -> Projection:
        """The nearest consistent state.

        Args:
            m: The measurement.
            prepared: What `prepare` gave for it, where that is at hand.

        Raises:
            SolveError: There is none near the measurement, limits and rows contradict one
                another, or the answer does not pass the check.
        """
        x, (rows, metric) = m.x, prepared or self.prepare(m)
        q, move, J, iterations = self._position.find(x.t, x.q, metric, rows)
        v = self._nearest_velocity(m, q, J, metric)
        raw = State(x.t, np.where(m.known, x.q, q), np.where(m.known_velocity, x.v, v))
        gap, J = rows if m.known.all() else self._position.rows(x.t, raw.q)
        rate = J.dot(raw.v) + self.system.rate(x.t, raw.q)
        excess = raw.q - np.minimum(np.maximum(raw.q, self.lower), self.upper)
        return Projection(
            *(State(x.t, q, v), move.lam, move.mu, gap, rate, excess),
            *(metric.undetermined, iterations, move.condition),
        )

    def _nearest_velocity(self, m: Measurement, q: Array, J: Array, metric: Metric) -> Array:
        x = m.x
        if (m.known_velocity != m.known).any():
            M = self.system.mass(x.q)
            metric = metric_of(M, J, m.known_velocity, self._amplification)
        rate, low, high = self.system.rate(x.t, q), -np.inf, np.inf
        floor = np.where(q <= self.lower + _REACHED, 0.0, low)
        ceiling = np.where(q >= self.upper - _REACHED, 0.0, high)
        c = -(J.dot(x.v) + rate)
        move = self._velocity.solve(metric, self._zero, J, c, floor - x.v, ceiling - x.v)
        v = np.minimum(np.maximum(x.v + move.p, floor), ceiling)
        left = float(np.abs(J.dot(v) + rate).max(initial=0.0))
        if not left <= _CONSISTENT * (1.0 + float(np.abs(x.v).max(initial=0.0))):
            raise SolveError(f"no consistent velocity: the rows keep a rate of {left:.1e} 1/s")
        return v
