"""Configurations that fit markers best: least squares on couplings, loops and limits.

    min f(y)   subject to   lower <= y <= upper,   g(t, q) = 0,   q = F(y)

by Newton's method with the exact Hessian of f, and of the rows by differences, many frames at
once: markers on a model that is simpler than a body miss by centimetres, and without second
derivatives the steps would shrink by a factor only. A step counts if it lowers f; else it is
damped.
Sources: K. Levenberg, Quart. Appl. Math. 2 (1944); J. Nocedal, S. Wright, Numerical Optimization,
2006, ch. 16 and 18.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.vectors import cross
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.box_qp import box_moves
from mbd_ros.core.rows.constraint import Constraint, Level
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowLayout
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED, BRANCH_STEP, LANDED
from mbd_ros.errors import SolveError

# ---- marker cost ------------------------------------------------------------------------------
# How far markers are from where they were seen, over many frames at once, with two derivatives.
#
#     f(y) = sum_i w_i |p_i(q) - m_i|^2 / (2 sum_i w_i) + sum_c w_c (q_c - q0_c)^2 / 2,   q = F(y)
#
# A marker that was not seen in a frame weighs 0 there. With the columns (v_k, omega_k) of the
# spatial Jacobian about the world's origin, a marker moves by u_ik = v_k + omega_k x p_i, and
#
#     d2 p_i / dq_j dq_k = omega_j x u_ik    (j not beyond k, symmetric in the axes of a free body)
#
# so that f, its slope and its exact Hessian follow from sums over the markers that a column moves:
# of w, w p, w p p', w e and w p e', e = p - m. The slopes of couplings join in with their
# curvature.


# Which coordinates carry markers, and which follow one another.


def orders(model: pin.Model, carriers: list[int]) -> tuple[Array, Array]:
    """What coordinates have to do with one another, and with markers.

    Returns:
        1 where j stands before k on a chain, 1/2 where both belong to one joint, else 0, shape
        (nv, nv); 1 where a coordinate moves a marker, shape (nv, n).
    """
    joint_of = np.zeros(model.nv, dtype=np.intp)
    for j, joint in enumerate(model.joints):
        if j:
            joint_of[joint.idx_v : joint.idx_v + joint.nv] = j
    above = np.zeros((model.njoints, model.njoints))
    for j in range(model.njoints):
        above[list(model.supports[j]), j] = 1.0
    np.fill_diagonal(above, 0.5)
    order = above[np.ix_(joint_of, joint_of)]
    moved = above[np.ix_(joint_of, np.array(carriers, dtype=np.intp))] > 0.0
    return order, moved.astype(np.float64)


def ancestry_of(couplings: Couplings, nv: int) -> Array:
    """1 where a joint follows an independent one, or is it, shape (nv, ny)."""
    ancestry = np.zeros((nv, len(couplings.v_index)))
    ancestry[couplings.v_index, np.arange(len(couplings.v_index))] = 1.0
    for pair in couplings.pairs:
        ancestry[pair.child_v] = ancestry[pair.parent_v]
    return ancestry


def q_of_v(model: pin.Model) -> Array:
    """Place in q of every velocity coordinate; those of free bodies get that of the body."""
    place = np.zeros(model.nv, dtype=np.intp)
    for joint in list(model.joints)[1:]:
        place[joint.idx_v : joint.idx_v + joint.nv] = joint.idx_q
    return place


Frames = NDArray[np.intp] | slice
_SHARES = 25  # numbers of a marker that are summed: w, w p, w p p', w e, w p e'


class Seen(NamedTuple):
    """What was seen in some frames.

    Attributes:
        places: Markers in the world less `Robot.origin` [m], shape (N, n, 3); anything finite
            where they were not seen.
        weights: Of the markers, 0 where they were not seen, shape (N, n); with a sum of 1, or 0.
        targets: Positions that coordinate tasks ask for [rad or m], shape (N, nv).
        times: [s], shape (N,).
    """

    places: Array
    weights: Array
    targets: Array
    times: Array

    def of(self, frames: Frames) -> "Seen":
        """Some of the frames."""
        return Seen(*(each[frames] for each in self))


class Cost(NamedTuple):
    """The objective f in some frames.

    Attributes:
        value: f [m^2], shape (N,).
        slope: By the independent coordinates, shape (N, ny).
        hessian: Shape (N, ny, ny).
        G: dq/dy, shape (N, nv, ny).
        misses: Markers less where they were seen [m], shape (N, n, 3).
    """

    value: Array
    slope: Array
    hessian: Array
    G: Array
    misses: Array


class MarkerCost:
    """The objective of markers on a robot.

    Args:
        robot: The robot.
        couplings: Its dependent joints.
        points: Where the markers are.
        tasks: Weights of coordinate tasks [m^2/rad^2 or 1], shape (nv,).

    Attributes:
        couplings: As given.
        ancestry: 1 where a joint moves with an independent coordinate, shape (nv, ny).
        y_of_q: Where the independent coordinates stand in q, those of a free body all where its
            coordinates begin, shape (ny,).
        reached: 1 where markers or tasks depend on an independent coordinate, shape (ny,).
    """

    def __init__(
        self, robot: Robot, couplings: Couplings, points: Sequence[Point], tasks: Array
    ) -> None:
        model = robot.model
        places = [robot.places.points[point.number] for point in points]
        self._model, self._data, self.couplings = model, pin.Data(model), couplings
        self._tasks, self._task_q = tasks, q_of_v(model)
        self._carriers = sorted({place.joint for place in places})
        of = [self._carriers.index(place.joint) for place in places]
        self._of_marker = np.array(of, dtype=np.intp)
        self._local = np.array([place.at.translation for place in places]).reshape(-1, 3)
        held = [self._data.oMi[joint] for joint in self._carriers]
        self._views = [(pose.rotation, pose.translation) for pose in held]  # live
        self._order, self._moved = orders(model, [place.joint for place in places])
        self.ancestry = ancestry_of(couplings, model.nv)
        self._coupled = bool(couplings.pairs)
        self.y_of_q = self._task_q[couplings.v_index]
        self.reached = ((self._moved.any(axis=1) | (tasks > 0.0)) @ self.ancestry > 0.0) * 1.0

    def at(self, q: Array, seen: Seen, bent: Array | None = None) -> Cost:
        """The objective.

        Args:
            q: Configurations that keep the couplings, shape (N, nq).
            seen: What was seen.
            bent: Shares, 0 to 1, of what misses add to the Hessian, shape (N,); all of it by
                default. Without it no direction has a negative curvature.
        """
        slopes, bends = self._slopes(q)
        p, J = self._kinematics(q)
        misses = p - seen.places
        bent = np.ones(len(q)) if bent is None else bent
        value = 0.5 * (seen.weights * (misses * misses).sum(axis=2)).sum(axis=1)
        slope, hessian = self._derivatives(p, misses, seen.weights, J, bent)
        if self._tasks.any():
            off = q[:, self._task_q] - seen.targets
            value += 0.5 * (off * off) @ self._tasks
            slope += self._tasks * off
            every = np.arange(len(self._tasks))
            hessian[:, every, every] += self._tasks
        G = self.ancestry * slopes[:, :, None]
        if not self._coupled:
            at = self.couplings.v_index
            return Cost(value, slope[:, at], hessian[:, at[:, None], at], G, misses)
        hessian = G.transpose(0, 2, 1) @ hessian @ G
        every = np.arange(G.shape[2])
        hessian[:, every, every] += (bends * slope * bent[:, None]) @ self.ancestry
        return Cost(value, (slopes * slope) @ self.ancestry, hessian, G, misses)

    def rows(self, q: Array) -> Array:
        """Derivatives of the markers by the independent coordinates, shape (N, n, 3, ny)."""
        p, J = self._kinematics(q)
        G = self.tangent(q)
        v, omega = J[:, None, :3].transpose(0, 1, 3, 2), J[:, None, 3:].transpose(0, 1, 3, 2)
        moves = (v + cross(omega, p[:, :, None])) * self._moved.T[None, :, :, None]
        return np.array(moves.transpose(0, 1, 3, 2) @ G[:, None])

    def moved(self, q: Array, dy: Array) -> Array:
        """Configurations after moves of the independent coordinates, couplings kept.

        Args:
            q: Shape (N, nq).
            dy: Shape (N, ny).
        """
        step = np.zeros((len(q), self._model.nv))
        step[:, self.couplings.v_index] = dy
        if self._model.nq == self._model.nv:
            return self.coupled(q + step)
        each = zip(q, step, strict=True)
        return self.coupled(np.array([pin.integrate(self._model, *pair) for pair in each]))

    def tangent(self, q: Array) -> Array:
        """G = dq/dy, shape (N, nv, ny)."""
        return self.ancestry * self._slopes(q)[0][:, :, None]

    def coupled(self, q: Array) -> Array:
        """The configurations with dependent joints brought to where couplings put them."""
        return self._expanded(q)[0] if self._coupled else q

    def _slopes(self, q: Array) -> tuple[Array, Array]:
        """dq/dz and d2q/dz2 of every joint by its independent ancestor, shapes (N, nv)."""
        if self._coupled:
            return self._expanded(q)[1:]
        shape = len(q), self._model.nv
        return np.ones(shape), np.zeros(shape)

    def _expanded(self, q: Array) -> tuple[Array, Array, Array]:
        """F with two derivatives, each by the independent ancestor of a joint."""
        nv, N = self._model.nv, len(q)
        if N == 1:  # numbers are faster than arrays of one
            one, first, second = np.array(q[0]), np.ones(nv), np.zeros(nv)
            self.couplings.expand(one, first, second)
            return one[None], first[None], second[None]
        whole, first, second = np.array(q.T), np.ones((nv, N)), np.zeros((nv, N))
        self.couplings.expand(whole, first, second)
        return whole.T, first.T, second.T

    def _kinematics(self, q: Array) -> tuple[Array, Array]:
        """Markers less `Robot.origin`, (N, n, 3), and Jacobians about it, (N, 6, nv)."""
        model, data, views = self._model, self._data, self._views
        N, nv = len(q), model.nv
        R, at, J = (
            np.empty((N, len(views), 3, 3)),
            np.empty((N, len(views), 3)),
            np.empty((N, 6, nv)),
        )
        for i in range(N):
            J[i] = pin.computeJointJacobians(model, data, q[i])
            for b, (rotation, translation) in enumerate(views):
                R[i, b], at[i, b] = rotation, translation
        of = self._of_marker
        return np.einsum("niab,ib->nia", R[:, of], self._local) + at[:, of], J

    def _derivatives(
        self, p: Array, e: Array, w: Array, J: Array, bent: Array
    ) -> tuple[Array, Array]:
        """Slope and Hessian of the markers' share by all velocities."""
        N, n, _ = p.shape
        shares = np.empty((N, n, _SHARES))
        wp = w[:, :, None] * p
        shares[:, :, 0], shares[:, :, 1:4] = w, wp
        shares[:, :, 4:13] = (wp[:, :, :, None] * p[:, :, None, :]).reshape(N, n, 9)
        shares[:, :, 13:16] = w[:, :, None] * e
        shares[:, :, 16:25] = (wp[:, :, :, None] * e[:, :, None, :]).reshape(N, n, 9)
        sums = self._moved @ shares  # (N, nv, 25)
        w0, w1, F = sums[:, :, :1], sums[:, :, 1:4], sums[:, :, 13:16]
        C = sums[:, :, 16:25]
        v, omega = J[:, :3].transpose(0, 2, 1), J[:, 3:].transpose(0, 2, 1)
        spin = C[:, :, [5, 6, 1]] - C[:, :, [7, 2, 3]]  # of p x e
        slope = (v * F).sum(axis=2) + (omega * spin).sum(axis=2)
        part = bent[:, None, None]
        turned = (part * C - sums[:, :, 4:13]).reshape(N, J.shape[2], 3, 3)
        linear = w0 * v + cross(omega, w1)
        angular = cross(v, part * F - w1) + _less_trace(turned, omega)
        half = v @ linear.transpose(0, 2, 1) + omega @ angular.transpose(0, 2, 1)
        half *= self._order
        return slope, half + half.transpose(0, 2, 1)


def _less_trace(A: Array, vectors: Array) -> Array:
    """(A - tr(A) 1) x of every matrix and vector."""
    trace = A[..., 0, 0] + A[..., 1, 1] + A[..., 2, 2]
    return np.array((A @ vectors[..., None])[..., 0] - trace[..., None] * vectors)


# ---- loop rows --------------------------------------------------------------------------------
# Rows besides the couplings, frame by frame, as a fit of configurations needs them.


_CLOSING = 50  # Newton steps
_STEP = 1.0e-6  # of difference quotients of the rows [rad or m]


class Chart(Protocol):
    """Configurations by independent coordinates."""

    def moved(self, q: Array, dy: Array) -> Array:
        """Configurations after moves of the independent coordinates, (N, nq) and (N, ny)."""

    def tangent(self, q: Array) -> Array:
        """G = dq/dy, shape (N, nv, ny)."""


class LoopRows:
    """Rows of positions that hold whatever force that takes.

    Args:
        robot: The robot.
        constraints: Rigid constraints besides the couplings; those of velocities are left out.
        chart: The independent coordinates.

    Attributes:
        names: Of the rows.
    """

    def __init__(self, robot: Robot, constraints: Sequence[Constraint], chart: Chart) -> None:
        blocks = RowLayout(constraints).of(Level.POSITION)
        self._rows = ConstraintRows(blocks, robot.model.nv)
        self.names = tuple(row.name for row in self._rows.rows)
        self._k, self._chart = Kinematics(robot), chart
        self._rest = np.zeros(robot.model.nv)

    def open(self, q: Array, times: Array) -> Array:
        """Largest |g| in each frame [m or rad], shape (N,)."""
        each = zip(q, times.tolist(), strict=True)
        return np.array([np.abs(self._residual(*pair)).max(initial=0.0) for pair in each])

    def worst(self, q: Array, t: float) -> str:
        """Name of the row that is furthest open in one frame."""
        return self.names[int(np.argmax(np.abs(self._residual(q, t))))]

    def near(self, q: Array, G: Array, slope: Array, times: Array) -> tuple[Array, Array, Array]:
        """What a quadratic program asks of closed rows.

        Args:
            q: Configurations, shape (N, nq).
            G: dq/dy there, shape (N, nv, ny).
            slope: Of the objective, shape (N, ny).
            times: [s], shape (N,).

        Returns:
            A = dg/dy, shape (N, m, ny); what is left to close, -g, shape (N, m); and the second
            derivative of nu' g, nu the multipliers that balance the slope, shape (N, ny, ny).
        """
        A = self._slopes(q, G, times)
        nu = np.array(
            [-np.linalg.lstsq(a.T, s, rcond=1.0e-10)[0] for a, s in zip(A, slope, strict=True)]
        )
        bend = np.empty((len(q), slope.shape[1], slope.shape[1]))
        for j, unit in enumerate(np.eye(slope.shape[1])):
            ends = []
            for way in (_STEP, -_STEP):
                at = self._chart.moved(q, np.broadcast_to(way * unit, slope.shape))
                there = self._slopes(at, self._chart.tangent(at), times)
                ends.append((nu[:, None, :] @ there)[:, 0])
            bend[:, j] = (ends[0] - ends[1]) / (2.0 * _STEP)
        each = zip(q, times.tolist(), strict=True)
        g = np.array([self._residual(*pair) for pair in each])
        return A, -g, 0.5 * (bend + bend.transpose(0, 2, 1))

    def closed(self, q: Array, times: Array, low: Array, high: Array, y_of_q: Array) -> Array:
        """Configurations nearby with closed rows; left open where that does not succeed.

        Args:
            q: Configurations within limits, shape (N, nq).
            times: [s], shape (N,).
            low: Smallest independent coordinates, shape (ny,).
            high: Largest ones, shape (ny,).
            y_of_q: Where they stand in q, shape (ny,).
        """
        limits = low, high, y_of_q
        each = zip(q, times.tolist(), strict=True)
        return np.array([self._closed(one, t, limits) for one, t in each])

    def _closed(self, q: Array, t: float, limits: tuple[Array, Array, Array]) -> Array:
        low, high, y_of_q = limits
        for _ in range(_CLOSING):
            g = self._residual(q, t)
            if np.abs(g).max(initial=0.0) <= LANDED:
                break
            A = self._slopes(q[None], self._chart.tangent(q[None]), np.array([t]))[0]
            dy = -np.linalg.lstsq(A, g, rcond=1.0e-10)[0]
            y = q[y_of_q]
            stopped = ((y <= low) & (dy < 0.0)) | ((y >= high) & (dy > 0.0))
            if stopped.any():
                dy = -np.linalg.lstsq(A * ~stopped, g, rcond=1.0e-10)[0]
            dy *= min(1.0, BRANCH_STEP / max(np.abs(dy).max(), LANDED))
            dy = np.minimum(np.maximum(dy, low - y), high - y)
            q = self._chart.moved(q[None], dy[None])[0]
        return q

    def _residual(self, q: Array, t: float) -> Array:
        self._k.refresh(q, self._rest, Reads.POSITION)
        return self._rows.residual(self._k, State(t, q, self._rest))

    def _slopes(self, q: Array, G: Array, times: Array) -> Array:
        """dg/dy, shape (N, m, ny)."""
        found = np.empty((len(q), len(self.names), G.shape[2]))
        for i, (one, t) in enumerate(zip(q, times.tolist(), strict=True)):
            self._k.refresh(one, self._rest, Reads.JACOBIAN)
            found[i] = self._rows.jacobian(self._k, State(t, one, self._rest)) @ G[i]
        return found


# ---- marker fit -------------------------------------------------------------------------------
# Configurations that fit markers best: least squares on couplings, loops and limits.


STILL = 1.0e-8  # a Newton step [rad or m] after which nothing of second order in it counts
_FLOOR = 1.0e-12  # of the largest entry of the Hessian, added so that it is regular
_FIRST, _GROWTH, _LARGEST = 1.0e-3, 10.0, 1.0e12  # of the damping
_ROUNDING = 1.0e-12  # of f: a step that raises it by less is a step of rounding
_NOTHING = 1.0e-28  # m^2, the same beside an f that is 0
_NEAR = 0.1  # a step without second derivatives [rad or m] after which they count
_TURN = 1.0  # longest step of a coordinate [rad or m]
_MAX_STEPS = 200
_CHUNK = 256  # frames at once, so that their numbers stay in the cache
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


class Fit(NamedTuple):
    """Configurations that fit markers, and how well.

    Attributes:
        q: Shape (N, nq).
        objective: f [m^2], shape (N,).
        remainder: Largest coordinate of the last Newton step [rad or m], shape (N,): what is left
            of the conditions of Karush, Kuhn and Tucker, over the curvature, before that step.
        open: Largest |g| of the rows [m or rad], shape (N,).
        misses: Markers less where they were seen [m], shape (N, n, 3).
        steps: Steps taken, shape (N,).
        settled: Whether the remainder is small enough, shape (N,).
        loose: Largest entry of the Hessian over its entry for each independent coordinate: inf
            where no marker that was seen tells of a coordinate, shape (N, ny).
    """

    q: Array
    objective: Array
    remainder: Array
    open: Array
    misses: Array
    steps: Indices
    settled: Bools
    loose: Array


class MarkerFit:
    """Fits frames, each from a start of its own.

    Args:
        cost: The objective.
        lower: Smallest independent coordinates, -inf without a limit, shape (ny,).
        upper: Largest ones, shape (ny,).
        loops: Rows that are kept besides the couplings, None without any.
    """

    def __init__(
        self, cost: MarkerCost, lower: Array, upper: Array, loops: LoopRows | None = None
    ) -> None:
        self.cost, self.lower, self.upper, self.loops = cost, lower, upper, loops
        self._y = cost.y_of_q

    def fit(self, start: Array, seen: Seen, *, far: bool = False, steps: int = _MAX_STEPS) -> Fit:
        """The best configurations near some starts.

        Args:
            start: Configurations, shape (N, nq); brought onto couplings, loops and limits first.
            seen: What was seen.
            far: Whether starts may be far off: the first steps do without second derivatives of
                markers then, which would lead to the next saddle.
            steps: At most so many.

        Raises:
            SolveError: Loops do not close near a start.
        """
        parts = [
            self._fit(start[i : i + _CHUNK], seen.of(slice(i, i + _CHUNK)), far, steps)
            for i in range(0, len(start), _CHUNK)
        ]
        return parts[0] if len(parts) == 1 else joined(parts)

    def _fit(self, start: Array, seen: Seen, far: bool, steps: int) -> Fit:
        q = self._allowed(self.cost.coupled(np.array(start)), seen.times)
        self._refuse_open(q, seen.times)
        done = _Frames(q, self.cost.at(q, seen, np.full(len(q), not far) * 1.0))
        done.flat_only[:] = far
        left, damping = np.arange(len(q)), np.zeros(len(q))
        for _ in range(steps):
            p, gain = self._steps(done, left, damping, seen)
            size = np.abs(p).max(axis=1, initial=0.0)
            done.remainder[left] = np.where(damping[left] > 0.0, np.inf, size)
            far_off = done.flat_only[left]
            done.flat_only[left] = far_off & (size > _NEAR)
            going = ~((size <= STILL) & ~far_off & (damping[left] == 0.0)) & (
                damping[left] < _LARGEST
            )
            self._finish(done, left[~going], p[~going], damping, seen.times)
            left, p, gain = left[going], p[going], gain[going]
            if not len(left):
                break
            at = self._allowed(self.cost.moved(done.q[left], p), seen.times[left])
            cost = self.cost.at(at, seen.of(left), 1.0 - done.flat_only[left])
            before = done.value[left]
            taken = (gain > 0.0) & (cost.value <= before * (1.0 + _ROUNDING) + _NOTHING)
            if self.loops is not None:
                taken &= self.loops.open(at, seen.times[left]) <= ASSEMBLED
            done.take(left[taken], at[taken], cost, taken)
            eased = damping[left] / _GROWTH
            eased[eased < _FIRST / _GROWTH] = 0.0
            damping[left] = np.where(taken, eased, np.maximum(damping[left] * _GROWTH, _FIRST))
        return self._fitted(done, damping, seen.times)

    def _finish(
        self, done: "_Frames", over: Indices, p: Array, damping: Array, times: Array
    ) -> None:
        """Take the last steps, which are too short to count in anything but the configuration."""
        last = damping[over] == 0.0
        over, p = over[last], p[last]
        if len(over):
            done.q[over] = self._allowed(self.cost.moved(done.q[over], p), times[over])

    def _steps(
        self, done: "_Frames", left: Indices, damping: Array, seen: Seen
    ) -> tuple[Array, Array]:
        """Moves of the independent coordinates, and what f should lose by them."""
        H, g = done.hessian[left], done.slope[left]
        n = np.arange(g.shape[1])
        A = b = None
        if self.loops is not None:
            A, b, bend = self.loops.near(done.q[left], done.G[left], g, seen.times[left])
            H = H + bend
        size = np.abs(H[:, n, n])
        K = H.copy()
        K[:, n, n] += damping[left, None] * size + _FLOOR * size.max(axis=1, initial=0.0)[:, None]
        K[:, n, n] += (size.max(axis=1, initial=0.0) == 0.0)[:, None]  # nothing was seen
        y = done.q[left][:, self._y]
        low = np.maximum(np.minimum(self.lower - y, 0.0), -_TURN)
        high = np.minimum(np.maximum(self.upper - y, 0.0), _TURN)
        moves = box_moves(K, g, low, high, A, b)
        p = moves.p
        gain = -((g * p).sum(axis=1) + 0.5 * (p * (K @ p[:, :, None])[:, :, 0]).sum(axis=1))
        return p, gain

    def _allowed(self, q: Array, times: Array) -> Array:
        """The nearest configurations within limits, with couplings and loops closed."""
        y = q[:, self._y]
        inside = np.minimum(np.maximum(y, self.lower), self.upper)
        if (inside != y).any():
            q = np.array(q)
            q[:, self._y] = np.where(inside != y, inside, y)
            q = self.cost.coupled(q)
        if self.loops is None:
            return q
        return self.loops.closed(q, times, self.lower, self.upper, self._y)

    def _refuse_open(self, q: Array, times: Array) -> None:
        if self.loops is None:
            return
        gaps = self.loops.open(q, times)
        at = int(np.argmax(gaps))
        if not gaps[at] <= ASSEMBLED:
            raise SolveError(
                f"t = {times[at]:.9g} s: the mechanism does not close: row "
                f"{self.loops.worst(q[at], times[at])} stays {gaps[at]:.3g} m or rad open"
            )

    def _fitted(self, done: "_Frames", damping: Array, times: Array) -> Fit:
        n = np.arange(done.slope.shape[1])
        curvature = np.abs(done.hessian[:, n, n])
        with np.errstate(divide="ignore", invalid="ignore"):
            loose = curvature.max(axis=1, initial=0.0)[:, None] / curvature
        open_ = np.zeros(len(done.q))
        if self.loops is not None:
            open_ = self.loops.open(done.q, times)
        settled = done.remainder <= STILL
        loose = np.where(np.isnan(loose), np.inf, loose)
        where, steps = (done.q, done.value, done.remainder, open_), done.steps
        return Fit(*where, done.misses, steps, settled, loose)


class _Frames:
    """Where each frame is, and its cost there."""

    def __init__(self, q: Array, cost: Cost) -> None:
        self.q, self.flat_only = q, np.zeros(len(q), dtype=np.bool_)
        self.value, self.slope, self.hessian, self.G, self.misses = cost
        self.remainder = np.full(len(q), np.inf)
        self.steps = np.zeros(len(q), dtype=np.intp)

    def take(self, frames: Indices, q: Array, cost: Cost, taken: Bools) -> None:
        """Move some frames."""
        self.q[frames] = q
        self.steps[frames] += 1
        for name, values in cost._asdict().items():
            getattr(self, name)[frames] = values[taken]


def joined(fits: list[Fit]) -> Fit:
    """The frames of several fits, one after the other."""
    return Fit(*(np.concatenate(parts) for parts in zip(*fits, strict=True)))


def chosen(first: Fit, second: Fit, is_second: Bools) -> Fit:
    """Frame by frame the first or the second of two fits of the same frames."""
    parts = []
    for one, other in zip(first, second, strict=True):
        shape = (-1, *(1,) * (one.ndim - 1))
        parts.append(np.where(is_second.reshape(shape), other, one))
    return Fit(*parts)
