"""The state nearest to a measured one, on the constraints and within the joint limits.

    position   min 1/2 p' W p,  p = q - q_m   subject to  g(t, q) = 0,  lower <= q <= upper
    velocity   min 1/2 p' W p,  p = v - v_m   subject to  J v + dg/dt = 0, and no motion out of a
                                                          limit that is reached;
                                                          here J has rows of velocities too

W is the mass matrix at the measured state; `nearest_state.metric_of` defines it for joints that
were not measured. Source: E. Eich, SIAM J. Numer. Anal. 30 (1993).
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.optimization.box_qp import Statistics
from mbd_ros.core.optimization.limit_forces import LimitForces
from mbd_ros.core.optimization.move_qp import Metric
from mbd_ros.core.projection.coupled_joints import CoupledJoints
from mbd_ros.core.projection.nearest_configuration import Rows
from mbd_ros.core.projection.nearest_coupled import NearestCoupled
from mbd_ros.core.projection.nearest_on_rows import NearestOnRows
from mbd_ros.core.projection.nearest_state import metric_of
from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class Measurement(NamedTuple):
    """A state of all joints of which some entries were measured.

    Attributes:
        x: The state; an entry that was not measured is the start of the search.
        known: Joints whose position was measured, shape (nv,).
        known_velocity: Joints whose velocity was measured, shape (nv,).
    """

    x: State
    known: NDArray[np.bool_]
    known_velocity: NDArray[np.bool_]


class Prepared(NamedTuple):
    """The beginning of a projection.

    Attributes:
        metric: Of positions.
        of_velocity: Of velocities.
        undetermined: Joints whose position neither measurement nor rows place, shape (nv,).
        is_whole: Whether all of both was measured.
        rows: At the measurement; None where they need not be formed.
    """

    metric: Metric
    of_velocity: Metric
    undetermined: NDArray[np.bool_]
    is_whole: bool
    rows: Rows | None = None


class ProjectedState(NamedTuple):
    """The nearest consistent state, and how far the measurement was from it.

    The multipliers are no forces of the mechanism: W (q - q_m) = J' multipliers + limit
    multipliers. They tell how hard each row pushed the measurement onto the constraints.

    Attributes:
        x: The state.
        multipliers: Of the rows, unit of the row's force times s^2, shape (m,).
        limit_multipliers: Of the limits, positive at a lower one, shape (nv,).
        gap: g of the measurement, joints that it lacks taken from x [rad or m], shape (m,).
        rate: g' likewise [1/s], shape (m,).
        excess: How far it is beyond a limit, negative below a lower one, shape (nv,).
        undetermined: Joints that neither measurement nor rows place: they stay, shape (nv,).
        iterations: Steps that the position took, of Newton's method or quadratic programs.
        condition: Condition number of the rows in the metric; 1 with couplings alone.
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
    """Finds the nearest consistent state and checks every result.

    Args:
        system: All joints of a fixed-base robot, the rows to keep as its `rows`.
        limits: Whether the position limits of the robot description are kept.
        amplification: Largest accepted ratio of an error in a reconstructed joint to errors of
            measured ones; a missing joint beyond it is held instead.

    Attributes:
        lower: Smallest position of each joint, shape (nv,).
        upper: Largest position of each joint, shape (nv,).

    Raises:
        ModelError: The base floats, or the system integrates other coordinates than all joints.
    """

    def __init__(
        self,
        system: System,
        *,
        limits: bool = True,
        amplification: Annotated[float, Within(1.0, 1.0e6), Unit("-")] = 20.0,
    ) -> None:
        joints, n = system.robot.joints, system.nv
        if system.robot.floating:
            free = ", ".join(base.title for base in system.robot.bases)
            raise ModelError(f"the projector takes joint states alone, and no poses of {free}")
        if n != system.model.nv:
            raise ModelError(f"tier {system.tier} eliminates joints: tier kkt keeps all")
        self.system, self._amplification = system, amplification
        self.lower, self.upper = np.full(n, -np.inf), np.full(n, np.inf)
        for joint in joints if limits else ():
            self.lower[joint.v], self.upper[joint.v] = joint.lower, joint.upper
        is_bounded = bool(np.isfinite([self.lower, self.upper]).any())
        self._limits = LimitForces(n, is_bounded), LimitForces(n, is_bounded)
        self._on_rows = NearestOnRows(system, self.lower, self.upper, *self._limits)
        self._none = np.zeros(n, dtype=np.bool_)
        held = system.held.constraints.parts
        parts = [part for part in held if isinstance(part, CouplingRows)]
        self._coupled: NearestCoupled | None = None
        if n and len(parts) == len(held):
            couplings = CoupledJoints(n, [pair for part in parts for pair in part.pairs])
            self._coupled = NearestCoupled(couplings, self.lower, self.upper, *self._limits)

    @property
    def statistics(self) -> tuple[int, Statistics]:
        """How often a limit acted, and how the QPs for that went."""
        counts = zip(*(limits.statistics for limits in self._limits), strict=True)
        solves = sum(limits.solves for limits in self._limits)
        return solves, Statistics(*(sum(count) for count in counts))

    def prepare(self, m: Measurement) -> Prepared:
        """Metrics of a measurement, with the joints that nothing determines.

        Raises:
            SolveError: The rows are not finite there.
        """
        x, M = m.x, self.system.mass(m.x.q).dense
        is_same = m.known is m.known_velocity or bool((m.known == m.known_velocity).all())
        is_whole = is_same and bool(m.known.all())
        if is_whole and self._coupled is not None:
            metric = Metric(M, None)
            return Prepared(metric, metric, self._none, is_whole)
        rows = self._on_rows.rows(x.t, x.q)
        metric, undetermined = metric_of(M, rows[1], m.known, self._amplification)
        of_velocity = metric
        if not is_same or self._on_rows.has_rates:
            J = self._on_rows.held(x.t, x.q, rows[1])
            of_velocity, _ = metric_of(M, J, m.known_velocity, self._amplification)
        return Prepared(metric, of_velocity, undetermined, is_whole, rows)

    def project(self, m: Measurement, prepared: Prepared | None = None) -> ProjectedState:
        """The nearest consistent state.

        Args:
            m: The measurement.
            prepared: What `prepare` gave for it, where that is at hand.

        Raises:
            SolveError: There is none near the measurement, limits and rows contradict one
                another, or the answer does not pass the check.
        """
        x, prepared = m.x, prepared or self.prepare(m)
        metric, of_velocity, undetermined, is_whole, rows = prepared
        near = None
        if self._coupled is not None:
            near = self._coupled.find(x, metric.W, of_velocity.W)
        if near is None:
            rows = rows or self._on_rows.rows(x.t, x.q)
            near = self._on_rows.find(x, metric, of_velocity, rows)
        raw, q, v = x, near.q, near.v
        if not is_whole:
            raw = State(x.t, np.where(m.known, x.q, q), np.where(m.known_velocity, x.v, v))
        if self._coupled is not None:
            gap, rate = self._coupled.violation(raw)
        else:
            gap, rate = self._on_rows.violation(raw, rows if is_whole else None)
        excess = raw.q - np.minimum(np.maximum(raw.q, self.lower), self.upper)
        return ProjectedState(
            *(State(x.t, q, v), near.lam, near.mu, gap, rate, excess),
            *(undetermined, near.iterations, near.condition),
        )
