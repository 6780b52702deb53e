"""The state nearest to a measured one, on the constraints and within the joint limits.

    position   min 1/2 p' W p,  p = q - q_m   subject to  g(t, q) = 0,  lower <= q <= upper
    velocity   min 1/2 p' W p,  p = v - v_m   subject to  J v + dg/dt = 0, and no motion out of a
                                                          limit that is reached;
                                                          here J has rows of velocities too

W is the mass matrix at the measured state; `metric_of` defines it for joints that were not
measured. `NearestOnRows` finds the state on rows of any kind: the configuration by successive
quadratic programs, each with the rows of the last configuration, the velocity by one program.
Robots whose only rows are couplings have a faster method in `coupled_joints`.

Sources: E. Eich, SIAM J. Numer. Anal. 30 (1993); J. Nocedal and S. Wright, Numerical Optimization,
2006, ch. 18, on successive quadratic programs.
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
_ACCURATE = 1.0e-9  # step after which nothing of second order in it counts
_SLOW = 0.1  # step over the last one from which second derivatives of the rows pay
_STIFF = 1.0e3  # of the rows beside second derivatives that are convex along them only
_HALF = 1.0e-5  # of the step of their difference quotients [rad or m]
_SMALLEST_SHARE = 1.0e-6
_LANDING = 50  # Newton steps
_ROUNDING = 1.0e-14
Rows = tuple[Array, Array]  # g and J
_OPTIMAL = 1.0e-8  # accepted residual of the optimality condition, relative
_NAMED = 4  # violations in an error message
_SHARE = 0.1  # of a free direction from which a joint counts as free


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
        held = system.bilateral.constraints.parts
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


class ProjectedState(NamedTuple):
    """The nearest consistent state, and how far the measurement was from it.

    The multipliers are no forces of the mechanism: W (q - q_m) = J' multipliers + limit
    multipliers. They tell how hard each row pushed the measurement onto the constraints.

    Attributes:
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
    """A consistent state of all joints from measured independent ones.

    Couplings give q = F(y) and v = G y'; then follows the nearest state on the loops, if there are
    any.

    Args:
        system: The system with the bilateral rows to keep.

    Attributes:
        moved: How far a joint of the last state was moved onto the loops [rad or m].
        dependent: Positions of the dependent joints of the last state [rad or m].
    """

    def __init__(self, system: System, couplings: Couplings) -> None:
        self._system = system
        self._couplings = couplings
        self._neutral = system.robot.neutral()
        self._nv = int(system.robot.model.nv)
        self._slopes: Slopes = [0.0] * len(couplings.pairs)
        self._dependent_q = [pair.child_q for pair in couplings.pairs]
        self.moved = 0.0
        self.dependent = np.zeros(len(couplings.pairs))

    def state(self, t: float, position: Array, velocity: Array) -> State:
        """The state at a time.

        Args:
            t: [s].
            position: Independent joints [rad or m], shape (ny,).
            velocity: [rad/s or m/s], shape (nv_y,).
        """
        q, v = self._neutral.copy(), np.zeros(self._nv)
        q[self._couplings.q_index], v[self._couplings.v_index] = position, velocity
        if self._couplings.pairs:
            self._couplings.expand(q, v, np.zeros(self._nv), self._slopes)
            self.dependent = q[self._dependent_q]
        x = State(t, q, v)
        if self._system.bilateral.rows:
            x = project(self._system, x)
            self.moved = float(np.abs(x.q - q).max())
        return x


class Prepared(NamedTuple):
    """The beginning of a projection.

    Attributes:
        undetermined: Joints whose position neither measurement nor rows place, shape (nv,).
        is_whole: Whether all of both was measured.
        rows: At the measurement; None where they need not be formed.
    """

    metric: Metric
    of_velocity: Metric
    undetermined: NDArray[np.bool_]
    is_whole: bool
    rows: Rows | None = None


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
        self._system = system
        self._lower = lower
        self._upper = upper
        self._configuration = NearestConfiguration(system, lower, upper, of_position)
        self._program = MoveQp(system.nv, of_velocity)
        self._zero = np.zeros(system.nv)
        self.has_rates = len(system.bilateral.rows) > len(system.rows)

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
        return self._system.bilateral.jacobian(t, q) if self.has_rates else J

    def violation(self, x: State, rows: Rows | None = None) -> tuple[Array, Array]:
        """Residual g and its rate g' at any state, shapes (m,) and (m,).

        Args:
            rows: What `rows` gives for it, where that is at hand.
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


def largest(values: Array) -> float:
    """Largest absolute value, 0 of none."""
    return float(np.abs(values).max(initial=0.0))


class NearestConfiguration:
    """Full steps first; where they do not converge, downhill along the manifold.

    The caller checks the result.

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
            measured: q_m; where it is beyond limits, the search begins at them, shape (nv,).
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


def metric_of(
    M: Array, J: Array, known: NDArray[np.bool_], amplification: float
) -> tuple[Metric, NDArray[np.bool_]]:
    """Mass metric of the measured joints.

    A joint that was not measured costs nothing to move, so that the rows alone place it. Some
    joints the rows leave free, or would place with errors larger than those of the measured
    joints by more than `amplification`. They keep their mass: they stay, as far as the rows let
    them.

    Args:
        M: Mass matrix, shape (n, n).
        J: Rows, shape (m, n).
        known: Measured joints, shape (n,).
        amplification: See above; in raw units, rad and m alike.

    Returns:
        The metric, and the joints without measurement that the rows leave free, shape (n,).
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
