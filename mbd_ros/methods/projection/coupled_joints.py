"""The nearest state of a robot whose only constraints are couplings of joints.

All joints are functions of the independent ones, q = F(y). Every dependent joint follows one other
joint, so that it has one independent ancestor z_k: row i of G = dF/dy holds one number, dF_i/dz_k,
and so do its second derivatives. The nearest state minimises over y alone:

    position   min 1/2 p' W p,  p = F(y) - q_m   subject to  lower <= F(y) <= upper
    velocity   min 1/2 p' W p,  p = G y' - v_m   subject to  floor <= G y' <= ceiling

Newton's method finds the position, with gradient G' W p and Hessian G' W G + diag(h), where h_k is
the sum of (W p)_i d2F_i/dz_k2 over the joints i that follow z_k. Source: J. Nocedal and S. Wright,
Numerical Optimization, 2006, ch. 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import CoupledPair, Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.move_qp import LimitForces, stops
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import BRANCH_STEP, NEAREST, ON_MANIFOLD, REACHED
from mbd_ros.errors import SolveError

_SUCCESS = eigenpy.ComputationInfo.Success
_ITERATIONS = 12
_WITHIN = 1.0e-13  # distance from a limit that is rounding [rad or m]
_SLOW = 0.1  # step over the last one from which a new Hessian pays
_SAMPLES = 2001  # of a coupling, over the range of its parent
_WIDE = 4.0 * np.pi  # rad or m: range of a parent without limits
_HALVINGS = 50
_SLACK = 1.0e-9  # rad or m by which a dependent joint may pass its limit
Bools = NDArray[np.bool_]


class CoupledJoints:
    """Couplings of a fixed-base robot, with one evaluation of each function for a configuration.

    Args:
        n: Number of joints.
        pairs: The couplings, parents before children.

    Attributes:
        free: The independent joints, shape (ny,).
        ancestry: 1 where a joint moves with an independent one, shape (n, ny).
    """

    def __init__(self, n: int, pairs: Sequence[CoupledPair]) -> None:
        self._pairs = tuple((pair.child_v, pair.parent_v, pair.function) for pair in pairs)
        self.free = np.setdiff1d(np.arange(n), [child for child, _, _ in self._pairs])
        self.ancestry = np.zeros((n, len(self.free)))
        self.ancestry[self.free, np.arange(len(self.free))] = 1.0
        for child, parent, _ in self._pairs:
            self.ancestry[child] = self.ancestry[parent]
        self._ones = [1.0] * n
        self._zeros = [0.0] * n

    def at(self, start: Array) -> Place:
        """Return F and its derivatives.

        Args:
            start: Positions whose independent ones are y [rad or m], shape (n,).
        """
        q, slope, curvature = start.tolist(), self._ones.copy(), self._zeros.copy()
        slopes = []
        for child, parent, function in self._pairs:
            q[child], first, second = function(q[parent])
            up = slope[parent]
            slope[child] = first * up
            curvature[child] = second * up * up + first * curvature[parent]
            slopes.append(first)
        values = np.array((q, slope, curvature))
        return Place(values[0], values[1], values[2], slopes)

    def multipliers(self, forces: Array, link_slopes: list[float]) -> Array:
        """Return the multipliers with which couplings transmit forces to independent joints, (m,).

        Args:
            forces: Forces on all joints, shape (n,); those on independent ones have no influence.
            link_slopes: `Place.link_slopes`.
        """
        transmitted = forces.tolist()
        for (child, parent, _), slope in zip(
            reversed(self._pairs), reversed(link_slopes), strict=True
        ):
            transmitted[parent] += slope * transmitted[child]
        return np.array([transmitted[child] for child, _, _ in self._pairs])

    def violation(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the residual g and its rate g' at any state of all joints, (m,) and (m,)."""
        at, speed, g, rate = q.tolist(), v.tolist(), [], []
        for child, parent, function in self._pairs:
            follows, slope, _ = function(at[parent])
            g.append(at[child] - follows)
            rate.append(speed[child] - slope * speed[parent])
        return np.array(g), np.array(rate)


class NearestCoupled:
    """Nearest state of a robot whose only constraints are couplings, by Newton's method.

    It first searches without limits, or with them if a limit was active in the last search.

    Args:
        joints: The couplings.
        lower: Lower limits of positions [rad or m], shape (n,).
        upper: Upper limits of positions [rad or m], shape (n,).
        of_position: Solver for the forces of position limits.
        of_velocity: Solver for the forces of limits that are reached.
    """

    def __init__(
        self,
        joints: CoupledJoints,
        lower: Array,
        upper: Array,
        of_position: LimitForces,
        of_velocity: LimitForces,
    ) -> None:
        self._joints = joints
        self._lower = lower
        self._upper = upper
        self._of_position = of_position
        self._of_velocity = of_velocity
        self._zero = np.zeros(len(lower))
        self._limits_act = False

    def find(self, x: State, W: Array, W_velocity: Array) -> Nearest | None:
        """Return the nearest state; None if this method does not find it.

        Args:
            x: The measurement, where the search starts.
            W: Metric of positions, positive definite along G, shape (n, n).
            W_velocity: Metric of velocities, positive definite along G, shape (n, n).
        """
        try:
            optimum = None if self._limits_act else self._stationary(x.q, W, limits_act=False)
            optimum = optimum or self._stationary(x.q, W, limits_act=True)
            if optimum is None:
                return None
            place, pull, mu, clearance, iterations = optimum
            q = place.q if clearance > _WITHIN else self._on_limits(place.q)
            v = self._velocity(q, place.slope, W_velocity, x.v, clearance <= REACHED)
        except SolveError:  # one linearisation failed; another method may succeed
            return None
        self._limits_act = mu is not None
        if not self._is_consistent(q, v):
            return None
        lam = self._joints.multipliers(pull if mu is None else pull - mu, place.link_slopes)
        return Nearest(q, v, lam, self._zero if mu is None else mu, iterations, 1.0)

    def violation(self, x: State) -> tuple[Array, Array]:
        """Return the residual g and its rate g' at any state, (m,) and (m,)."""
        return self._joints.violation(x.q, x.v)

    def _stationary(self, measured: Array, W: Array, *, limits_act: bool) -> _Stationary | None:
        """Find the optimum by Newton's method, with a new Hessian where convergence is slow."""
        ancestry, start = self._joints.ancestry, measured
        if limits_act:
            start = np.minimum(np.maximum(measured, self._lower), self._upper)
        tangent, mu, length, last = None, None, math.inf, math.inf
        for iteration in range(1, _ITERATIONS + 1):
            place = self._joints.at(start)
            pull = W.dot(place.q - measured)
            gradient = (pull * place.slope).dot(ancestry)
            if tangent is None or limits_act or length > _SLOW * last:
                forces = pull if mu is None else pull - mu
                tangent = Tangent(ancestry, place.slope, W, forces * place.curvature)
                is_convex = tangent.is_convex
                if not is_convex:
                    tangent = Tangent(ancestry, place.slope, W)
            step = tangent.along(-gradient)
            if limits_act:
                ends = self._lower - place.q, self._upper - place.q
                mu = self._of_position.solve(tangent, step, *ends)
                step = step if mu is None else step + tangent.moves(mu)
            last, length = length, _norm(step)
            if length <= NEAREST:
                clearance = self._clearance(place.q)
                if clearance >= -_WITHIN and (is_convex or mu is not None):
                    return _Stationary(place, pull, mu, clearance, iteration)
                if not limits_act:
                    return None
            start = place.q + (step if length <= BRANCH_STEP else step * (BRANCH_STEP / length))
        return None

    def _velocity(
        self, q: Array, slope: Array, W: Array, measured: Array, is_at_limit: bool
    ) -> Array:
        tangent = Tangent(self._joints.ancestry, slope, W)
        v = tangent.moves(W.dot(measured))
        if is_at_limit:
            floor, ceiling = stops(q, self._lower, self._upper)
            mu = self._of_velocity.solve(tangent, v, floor, ceiling)
            v = v if mu is None else v + tangent.moves(mu)
            v = np.minimum(np.maximum(v, floor), ceiling)
        return v

    def _clearance(self, q: Array) -> float:
        """Return the distance from the nearest limit, negative beyond it [rad or m]."""
        return min(min((q - self._lower).tolist()), min((self._upper - q).tolist()))

    def _on_limits(self, q: Array) -> Array:
        """Return the configuration with joints exactly on the limits that they reach."""
        q = np.where(q - self._lower <= _WITHIN, self._lower, q)
        return np.where(self._upper - q <= _WITHIN, self._upper, q)

    def _is_consistent(self, q: Array, v: Array) -> bool:
        g, rate = self._joints.violation(q, v)
        size = 1.0 + _norm(v)
        return _norm(g) <= ON_MANIFOLD and _norm(rate) <= ON_MANIFOLD * size < math.inf


class _Stationary(NamedTuple):
    """Optimum of the position problem.

    Attributes:
        place: Positions and derivatives there.
        pull: W p, shape (n,).
        mu: Forces of the limits, shape (n,); None if no limit is active.
        clearance: Distance from the nearest limit [rad or m].
        iterations: Number of Newton steps.
    """

    place: Place
    pull: Array
    mu: Array | None
    clearance: float
    iterations: int


def _norm(vector: Array) -> float:
    return math.sqrt(vector.dot(vector))


class Nearest(NamedTuple):
    """Nearest state, verified.

    Attributes:
        q: Configuration, shape (n,).
        v: Velocity, shape (n,).
        lam: Multipliers of the rows at q, shape (m,).
        mu: Multipliers of the limits at q, shape (n,).
        iterations: Number of iterations for q.
        condition: Condition number of the rows in the metric; 1 where none were factorised.
    """

    q: Array
    v: Array
    lam: Array
    mu: Array
    iterations: int
    condition: float


class Place(NamedTuple):
    """F and its derivatives at one y.

    Attributes:
        q: All positions [rad or m], shape (n,).
        slope: dF_i/dz_k of its ancestor, shape (n,).
        curvature: d2F_i/dz_k2, shape (n,).
        link_slopes: f' of each coupling at its parent, length m.
    """

    q: Array
    slope: Array
    curvature: Array
    link_slopes: list[float]


class Tangent:
    """Displacements p = G dy along couplings with the Hessian H = G' W G + diag(h).

    Args:
        ancestry: `CoupledJoints.ancestry`, shape (n, ny).
        slope: dF_i/dz_k, shape (n,).
        W: Metric, shape (n, n).
        bend: Contribution of each joint to h, shape (n,).
    """

    def __init__(self, ancestry: Array, slope: Array, W: Array, bend: Array | None = None) -> None:
        self._ancestry = ancestry
        self._G = ancestry * slope[:, None]
        H = self._G.T.dot(W.dot(self._G))
        if bend is not None:
            H += ancestry.T.dot(bend[:, None] * ancestry)
        self._cholesky = eigenpy.LLT(H)

    @property
    def is_convex(self) -> bool:
        """Whether H is positive definite."""
        return bool(self._cholesky.info() == _SUCCESS)

    def along(self, reduced: Array) -> Array:
        """Return the displacements due to forces on the independent joints, one a column."""
        return self._G.dot(self._cholesky.solve(reduced).reshape(reduced.shape))

    def moves(self, forces: Array) -> Array:
        """Return the displacements due to forces on all joints, one a column."""
        return self.along(self._G.T.dot(forces))

    def mobility(self) -> Array:
        """Return the displacement per force of each joint's independent ancestor, shape (n,)."""
        reduced = self._ancestry.T
        moves = self._cholesky.solve(reduced).reshape(reduced.shape)
        return np.array((moves * reduced).sum(axis=0))


def independent_limits(robot: Robot, couplings: Couplings) -> tuple[Array, Array]:
    """Return the range of the independent coordinates in which all joints are within limits.

    An independent joint can move as long as the joints that follow it stay within their limits.
    The interval around 0 is searched on a grid over its range, and its ends by bisection.

    Returns:
        Lower and upper limits [rad or m], shapes (ny,) and (ny,); infinite for free bodies.
    """
    nv = robot.model.nv
    low, high = np.full(nv, -np.inf), np.full(nv, np.inf)
    for joint in robot.joints:
        low[joint.v], high[joint.v] = joint.lower, joint.upper
    followed = {pair.parent_v for pair in couplings.pairs} & set(couplings.v_index.tolist())
    for v in sorted(followed):
        low[v], high[v] = _dependent_range(robot, couplings, v, low, high)
    return low[couplings.v_index], high[couplings.v_index]


def _dependent_range(
    robot: Robot, couplings: Couplings, v: int, low: Array, high: Array
) -> tuple[float, float]:
    """Return the interval of an independent joint in which its dependent joints are in limits.

    If there is no such interval, the limits of dependent joints are ignored.
    """
    (q_of,) = (joint.q for joint in robot.joints if joint.v == v)
    ends = max(low[v], -_WIDE), min(high[v], _WIDE)

    dependent = [joint for joint in robot.joints if joint.name in couplings.dependent]

    def is_within(z: Array) -> Bools:
        q = np.repeat(robot.neutral()[:, None], len(z), axis=1)
        q[q_of] = z
        moving = np.zeros((robot.model.nv, len(z)))
        moving[v] = 1.0
        couplings.expand(q, moving, np.zeros(moving.shape))
        inside: Bools = np.ones(len(z), dtype=np.bool_)
        for joint in dependent:
            if moving[joint.v].any():
                inside &= q[joint.q] >= joint.lower - _SLACK
                inside &= q[joint.q] <= joint.upper + _SLACK
        return inside

    z = np.linspace(*ends, _SAMPLES)
    inside = is_within(z)
    if inside.all() or not inside.any():
        return float(low[v]), float(high[v])
    middle = int(np.argmin(np.where(inside, np.abs(z), np.inf)))
    left, right = np.flatnonzero(~inside[:middle]), np.flatnonzero(~inside[middle:])
    lower, upper = float(low[v]), float(high[v])
    if len(left):
        lower = _edge(is_within, z[left[-1] + 1], z[left[-1]])
    if len(right):
        upper = _edge(is_within, z[middle + right[0] - 1], z[middle + right[0]])
    return lower, upper


def _edge(is_within: Callable[[Array], Bools], inside: float, outside: float) -> float:
    """Return the position between two others where a limit is reached, by bisection."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        if is_within(np.array([middle]))[0]:
            inside = middle
        else:
            outside = middle
    return inside
