"""Projection of a measured state onto the constraints, within joint limits.

    position   min 1/2 p' W p,  p = q - q_m   subject to  g(t, q) = 0,  lower <= q <= upper
    velocity   min 1/2 p' W p,  p = v - v_m   subject to  J v + dg/dt = 0, and no motion beyond a
                                                          limit that is reached;
                                                          J includes velocity constraints

W is the mass matrix at the measured state; `metric_of` defines it for joints that were not
measured. `NearestOnRows` handles constraints of any kind: it finds the configuration by sequential
quadratic programming and the velocity by one quadratic program.
Robots whose only rows are couplings have a faster method in `coupled_joints`.

Sources: E. Eich, SIAM J. Numer. Anal. 30 (1993); J. Nocedal and S. Wright, Numerical Optimization,
2006, ch. 18, on sequential quadratic programming.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.optimization.box_qp import Statistics
from mbd_ros.core.optimization.move_qp import (
    LimitForces,
    Metric,
    Move,
    MoveQp,
    is_convex,
    row_weight,
    stops,
)
from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.rows.constraint_rows import CouplingRows
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import BRANCH_STEP, LANDED, NEAREST, ON_MANIFOLD
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.projection.assembly import project
from mbd_ros.methods.projection.coupled_joints import CoupledJoints, Nearest, NearestCoupled

_QUICK = 30  # quadratic programs with full steps
_PATIENT = 60  # quadratic programs downhill along the manifold
_ACCURATE = 1.0e-9  # step whose second-order terms are below rounding
_SLOW = 0.1  # ratio of two steps above which second derivatives of the rows pay off
_STIFF = 1.0e3  # weight of the rows in a Hessian that is convex only along them
_HALF = 1.0e-5  # half step of central differences [rad or m]
_SMALLEST_SHARE = 1.0e-6
_LANDING = 50  # Newton steps
_ROUNDING = 1.0e-14
Rows = tuple[Array, Array]  # g and J
_OPTIMAL = 1.0e-8  # accepted residual of the optimality condition, relative
_NAMED = 4  # violations in an error message
_SHARE = 0.1  # share in a free direction above which a joint counts as free


class StateProjector:
    """Projects measured states onto the nearest consistent state, and verifies every result.

    Args:
        system: All joints of a fixed-base robot, with the constraints as its `rows`.
        limits: Whether the result stays within the position limits of the robot description.
        amplification: Largest accepted ratio of the error of a reconstructed joint to errors of
            measured ones; an unmeasured joint beyond it keeps its position instead.

    Attributes:
        lower: Lower limit of each joint, shape (nv,).
        upper: Upper limit of each joint, shape (nv,).

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
            raise ModelError(
                f"the projector needs a fixed base, since joint states have no poses of {free}"
            )
        if n != system.model.nv:
            raise ModelError(
                f"tier {system.tier} eliminates joints; use tier kkt for a projection"
            )
        self.system = system
        self._amplification = amplification
        self.lower = np.full(n, -np.inf)
        self.upper = np.full(n, np.inf)
        for joint in joints if limits else ():
            self.lower[joint.v], self.upper[joint.v] = joint.lower, joint.upper
        is_bounded = bool(np.isfinite([self.lower, self.upper]).any())
        self._limits = LimitForces(n, is_bounded), LimitForces(n, is_bounded)
        self._on_rows = NearestOnRows(system, self.lower, self.upper, *self._limits)
        self._none = np.zeros(n, dtype=np.bool_)
        bilateral = system.bilateral.constraints.parts
        parts = [part for part in bilateral if isinstance(part, CouplingRows)]
        self._coupled: NearestCoupled | None = None
        if n and len(parts) == len(bilateral):
            couplings = CoupledJoints(n, [pair for part in parts for pair in part.pairs])
            self._coupled = NearestCoupled(couplings, self.lower, self.upper, *self._limits)

    @property
    def statistics(self) -> tuple[int, Statistics]:
        """Number of quadratic programs for limits, and their statistics."""
        counts = zip(*(limits.statistics for limits in self._limits), strict=True)
        solves = sum(limits.solves for limits in self._limits)
        return solves, Statistics(*(sum(count) for count in counts))

    def prepare(self, m: Measurement) -> Prepared:
        """Return the metrics of a measurement, and the joints that are not determined.

        Raises:
            SolveError: The rows are not finite at the measurement.
        """
        x, M = m.x, self.system.mass(m.x.q).dense
        is_same = m.known is m.known_velocity or bool((m.known == m.known_velocity).all())
        is_complete = is_same and bool(m.known.all())
        if is_complete and self._coupled is not None:
            metric = Metric(M, None)
            return Prepared(metric, metric, self._none, is_complete)
        rows = self._on_rows.rows(x.t, x.q)
        metric, undetermined = metric_of(M, rows[1], m.known, self._amplification)
        velocity_metric = metric
        if not is_same or self._on_rows.has_rates:
            J = self._on_rows.velocity_rows(x.t, x.q, rows[1])
            velocity_metric, _ = metric_of(M, J, m.known_velocity, self._amplification)
        return Prepared(metric, velocity_metric, undetermined, is_complete, rows)

    def project(self, m: Measurement, prepared: Prepared | None = None) -> ProjectedState:
        """Return the nearest consistent state.

        Args:
            m: The measurement.
            prepared: Result of `prepare` for m; None to compute it.

        Raises:
            SolveError: There is none near the measurement, limits and rows contradict each other,
                or the result does not pass its verification.
        """
        x, prepared = m.x, prepared or self.prepare(m)
        metric, velocity_metric, undetermined, is_complete, rows = prepared
        near = None
        if self._coupled is not None:
            near = self._coupled.find(x, metric.W, velocity_metric.W)
        if near is None:
            rows = rows or self._on_rows.rows(x.t, x.q)
            near = self._on_rows.find(x, metric, velocity_metric, rows)
        raw, q, v = x, near.q, near.v
        if not is_complete:
            raw = State(x.t, np.where(m.known, x.q, q), np.where(m.known_velocity, x.v, v))
        if self._coupled is not None:
            gap, rate = self._coupled.violation(raw)
        else:
            gap, rate = self._on_rows.violation(raw, rows if is_complete else None)
        excess = raw.q - np.minimum(np.maximum(raw.q, self.lower), self.upper)
        return ProjectedState(
            *(State(x.t, q, v), near.lam, near.mu, gap, rate, excess),
            *(undetermined, near.iterations, near.condition),
        )


class ProjectedState(NamedTuple):
    """Nearest consistent state, and how far the measurement was from it.

    The multipliers are not forces of the mechanism. They satisfy W (q - q_m) = J' multipliers +
    limit_multipliers, so they show how much each row displaced the measurement.

    Attributes:
        x: The consistent state.
        multipliers: Multipliers of the rows [unit of the row's force times s^2], shape (m,).
        limit_multipliers: Multipliers of the limits, positive at a lower one, shape (nv,).
        gap: g of the measurement, with unmeasured joints from x [rad or m], shape (m,).
        rate: g' of the measurement, with unmeasured joints from x [1/s], shape (m,).
        excess: Distance beyond a limit, negative below a lower one, shape (nv,).
        undetermined: Joints that neither measurement nor rows determine; they keep their position,
            shape (nv,).
        iterations: Newton steps or quadratic programs for the position.
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


class ObservedState:
    """Consistent state of all joints from measured independent joints.

    Couplings yield q = F(y) and v = G y'; in a mechanism with loops the result is projected onto
    them.

    Args:
        system: The system with the bilateral rows to keep.

    Attributes:
        correction: Largest displacement of a joint of the last state by the projection [rad or m].
        dependent: Positions of the dependent joints of the last state [rad or m].
    """

    def __init__(self, system: System, couplings: Couplings) -> None:
        self._system = system
        self._couplings = couplings
        self._neutral = system.robot.neutral()
        self._nv = int(system.robot.model.nv)
        self._slopes: Slopes = [0.0] * len(couplings.pairs)
        self._dependent_q = [pair.child_q for pair in couplings.pairs]
        self.correction = 0.0
        self.dependent = np.zeros(len(couplings.pairs))

    def state(self, t: float, position: Array, velocity: Array) -> State:
        """Return the state at a time.

        Args:
            t: Time [s].
            position: Positions of the independent joints [rad or m], shape (ny,).
            velocity: Their velocities [rad/s or m/s], shape (nv_y,).
        """
        q, v = self._neutral.copy(), np.zeros(self._nv)
        q[self._couplings.q_index], v[self._couplings.v_index] = position, velocity
        if self._couplings.pairs:
            self._couplings.expand(q, v, np.zeros(self._nv), self._slopes)
            self.dependent = q[self._dependent_q]
        x = State(t, q, v)
        if self._system.bilateral.rows:
            x = project(self._system, x)
            self.correction = float(np.abs(x.q - q).max())
        return x


class Prepared(NamedTuple):
    """Metrics and rows of a measurement.

    Attributes:
        metric: Metric of positions.
        velocity_metric: Metric of velocities.
        undetermined: Joints whose position is not determined, shape (nv,).
        is_complete: Whether all positions and velocities were measured.
        rows: g and J at the measurement; None if they are not needed.
    """

    metric: Metric
    velocity_metric: Metric
    undetermined: NDArray[np.bool_]
    is_complete: bool
    rows: Rows | None = None


class NearestOnRows:
    """Nearest state on constraints of any kind, by quadratic programs.

    Args:
        system: All joints of a fixed-base robot.
        lower: Lower limits of positions [rad or m], shape (n,).
        upper: Upper limits of positions [rad or m], shape (n,).
        of_position: Solver for the forces of position limits.
        of_velocity: Solver for the forces of limits that are reached.

    Attributes:
        has_rates: Whether there are velocity constraints beside those of positions.
    """

    def __init__(
        self,
        system: System,
        lower: Array,
        upper: Array,
        of_position: LimitForces,
        of_velocity: LimitForces,
    ) -> None:
        self._system = system
        self._lower = lower
        self._upper = upper
        self._configuration = NearestConfiguration(system, lower, upper, of_position)
        self._program = MoveQp(system.nv, of_velocity)
        self._zero = np.zeros(system.nv)
        self.has_rates = len(system.bilateral.rows) > len(system.rows)

    def rows(self, t: float, q: Array) -> Rows:
        """Return the residual g and the Jacobian J, shapes (m,) and (m, n).

        Raises:
            SolveError: They are not finite.
        """
        return self._configuration.rows(t, q)

    def find(self, x: State, metric: Metric, velocity_metric: Metric, rows: Rows) -> Nearest:
        """Return the nearest state.

        Args:
            x: The measurement, where the search starts.
            metric: Metric of positions.
            velocity_metric: Metric of velocities.
            rows: Result of `rows` at x.

        Raises:
            SolveError: There is none near x, limits and rows contradict each other, or the result
                does not pass its verification.
        """
        nearest = self._configuration.find(x.t, x.q, metric, rows)
        if nearest is None:
            raise SolveError(self._too_far(x.q, rows[0]))
        q, move, at_q, iterations = nearest
        _check(q - x.q, metric, move, at_q)
        v = self._velocity(x, q, self.velocity_rows(x.t, q, at_q[1]), velocity_metric)
        return Nearest(q, v, move.lam, move.mu, iterations, move.condition)

    def velocity_rows(self, t: float, q: Array, J: Array) -> Array:
        """Return the Jacobian of all rows for velocities, given that for positions at q."""
        return self._system.bilateral.jacobian(t, q) if self.has_rates else J

    def violation(self, x: State, rows: Rows | None = None) -> tuple[Array, Array]:
        """Return the residual g and its rate g' at any state, shapes (m,) and (m,).

        Args:
            x: State of all joints.
            rows: Result of `rows` at x; None to compute it.
        """
        g, J = rows or self.rows(x.t, x.q)
        return g, J.dot(x.v) + self._system.rate(x.t, x.q)

    def _velocity(self, x: State, q: Array, J: Array, metric: Metric) -> Array:
        rate = self._system.bilateral.rate(x.t, q)
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
            raise SolveError(
                f"no consistent velocity: a rate of {left:.1e} 1/s remains in the rows"
            )
        return v

    def _too_far(self, q: Array, g: Array) -> str:
        """Return the message for a measurement without a consistent state near it."""
        beyond = q - np.minimum(np.maximum(q, self._lower), self._upper)
        off = [(row.name, g[i]) for i, row in enumerate(self._system.rows)]
        off += [(f"limit of {joint.name}", beyond[joint.v]) for joint in self._system.robot.joints]
        off.sort(key=lambda item: -abs(item[1]))
        worst = ", ".join(f"{name} by {distance:.3g}" for name, distance in off[:_NAMED])
        return f"no consistent state near the measured one, which violates {worst} (rad or m)"


def _check(p: Array, metric: Metric, move: Move, rows: Rows) -> None:
    """Verify that a solution is on the manifold and satisfies the optimality condition."""
    g, J = rows
    if not largest(g) <= ON_MANIFOLD:
        raise SolveError(f"the projected state is {largest(g):.1e} rad or m off its constraints")
    pull = metric.W.dot(p)
    left = largest(pull - J.T.dot(move.lam) - move.mu)
    if not left <= _OPTIMAL * largest(pull) + NEAREST * largest(metric.W):
        raise SolveError(f"the projected state is not the nearest one: residual {left:.1e}")


def largest(values: Array) -> float:
    """Return the largest absolute value, 0 for an empty array."""
    return float(np.abs(values).max(initial=0.0))


class NearestConfiguration:
    """Nearest configuration by sequential quadratic programming.

    Full steps come first; where they do not converge, the search descends along the manifold. The
    caller verifies the result.

    Args:
        system: All joints of a fixed-base robot.
        lower: Smallest positions [rad or m], shape (nv,).
        upper: Largest positions [rad or m], shape (nv,).
    """

    def __init__(self, system: System, lower: Array, upper: Array, limits: LimitForces) -> None:
        self._system = system
        self._lower = lower
        self._upper = upper
        self._program = MoveQp(system.nv, limits)
        self._zero = np.zeros(system.nv)
        self._far = np.full(system.nv, np.inf)

    def rows(self, t: float, q: Array) -> Rows:
        """Return the residual g and the Jacobian J, shapes (m,) and (m, nv).

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
        """Return the nearest configuration.

        Args:
            t: Time [s].
            measured: q_m, shape (nv,); where it is beyond limits, the search starts at them.
            metric: Metric of positions.
            rows: Result of `rows` at q_m.

        Returns:
            q, its multipliers, g and J at q, and the number of quadratic programs; None if the
            search fails.

        Raises:
            SolveError: Rows or masses are not finite during the search.
        """
        start = self._clipped(measured)
        if (start != measured).any():
            rows = self.rows(t, start)
        optimum = self._full_steps(t, measured, start, metric, rows)
        optimum = optimum or self._downhill(t, measured, start, metric)
        if optimum is None:
            return None
        move, iterations = optimum
        q = self._clipped(measured + move.p)
        rows = self.rows(t, q)
        if largest(rows[0]) > ON_MANIFOLD:  # the program satisfies limits relative to its forces
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
        """Descend with iterates on the manifold, each nearer than the last one."""
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
                candidate = self._landed(t, q + move.p * min(share, BRANCH_STEP / length), metric)
                if candidate is not None:
                    away = candidate - measured
                    if away.dot(metric.W.dot(away)) <= least:
                        q = candidate
                        break
                share *= 0.5
            else:
                return None
            H = self._curved(t, q, move.lam, metric)
        return None

    def _towards(self, q: Array, pull: Array, H: Metric, rows: Rows) -> Move | None:
        """Return the step from q with the Hessian H; None where limits allow no step."""
        g, J = rows
        try:
            return self._program.solve(H, pull, J, -g, self._lower - q, self._upper - q)
        except SolveError:
            return None

    def _curved(self, t: float, q: Array, lam: Array, metric: Metric) -> Metric:
        """Return W minus the curvature of the rows if that is convex along them, else W."""
        n = len(q)
        H, half = metric.W.copy(), np.zeros(n)
        for i in range(n):
            half[i] = _HALF
            change = self.rows(t, q + half)[1] - self.rows(t, q - half)[1]
            H[:, i] -= change.T.dot(lam) / (2.0 * _HALF)
            half[i] = 0.0
        H = 0.5 * (H + H.T)
        _, J = self.rows(t, q)
        weight = _STIFF * row_weight(self._system.mass(q).dense, J)
        curved = Metric(H, weight)
        return curved if is_convex(curved, J) else metric

    def _landed(self, t: float, q: Array, metric: Metric) -> Array | None:
        """Solve g = 0 by Newton's method with the smallest steps; None if it fails."""
        for _ in range(_LANDING):
            g, J = self.rows(t, q)
            if largest(g) <= LANDED:
                return q
            move = self._towards(q, self._zero, metric, (g, J))
            if move is None:  # a later linearisation may satisfy the limits again
                move = self._program.solve(metric, self._zero, J, -g, -self._far, self._far)
            length = largest(move.p)
            if not length > LANDED:
                break
            q = q + move.p * min(1.0, BRANCH_STEP / length)
        g, _ = self.rows(t, q)
        return q if largest(g) <= ON_MANIFOLD else None

    def _clipped(self, q: Array) -> Array:
        return np.minimum(np.maximum(q, self._lower), self._upper)


def metric_of(
    M: Array, J: Array, known: NDArray[np.bool_], amplification: float
) -> tuple[Metric, NDArray[np.bool_]]:
    """Return the mass metric of the measured joints.

    An unmeasured joint has no weight, so that the rows alone determine it. Joints that the rows
    leave free, or would determine with errors larger than those of measured joints by more than
    `amplification`, keep their mass: they stay where they are, as far as the rows allow.

    Args:
        M: Mass matrix, shape (n, n).
        J: Jacobian of the rows, shape (m, n).
        known: Measured joints, shape (n,).
        amplification: Largest accepted amplification of errors, with rad and m treated alike.

    Returns:
        The metric, and the unmeasured joints that the rows leave free, shape (n,).
    """
    undetermined = np.zeros(len(M), dtype=np.bool_)
    if known.all():
        return Metric(M, None), undetermined
    free = (~known).nonzero()[0]
    W = np.where(known[:, None] & known, M, 0.0)
    length = np.sqrt((J * J).sum(axis=1))
    reach = J[:, free] / np.where(length > 0.0, length, 1.0)[:, None]
    _, sizes, directions = np.linalg.svd(reach)
    rank = int(np.count_nonzero(sizes * amplification > 1.0))
    null = directions[rank:].T
    block = np.ix_(free, free)
    W[block] = null.dot(null.T.dot(M[block]).dot(null)).dot(null.T)
    undetermined[free] = (np.abs(null) > _SHARE).any(axis=1)
    return Metric(W, row_weight(M, J)), undetermined
