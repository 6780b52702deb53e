"""Configurations that fit markers best: least squares on couplings, loops and limits.

    min f(y)   subject to   lower <= y <= upper,   g(t, q) = 0,   q = F(y)

by Newton's method with the exact Hessian of f, and of the rows by differences, many frames at
once: markers on a model that is simpler than a body miss by centimetres, and without second
derivatives the steps would shrink by a factor only. A step counts if it lowers f; else it is
damped.
Sources: K. Levenberg, Quart. Appl. Math. 2 (1944); J. Nocedal, S. Wright, Numerical Optimization,
2006, ch. 16 and 18.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.box_qp import box_moves
from mbd_ros.core.rows.constraint import Constraint, Level
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowLayout
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED, BRANCH_STEP, LANDED
from mbd_ros.errors import SolveError
from mbd_ros.features.markers.marker_cost import Cost, MarkerCost, Seen

_CLOSING = 50  # Newton steps
_STEP = 1.0e-6  # of difference quotients of the rows [rad or m]
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


class MarkerFit:
    """Fits frames, each from a start of its own.

    Args:
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
        self, done: _Frames, over: Indices, p: Array, damping: Array, times: Array
    ) -> None:
        """Take the last steps, which are too short to count in anything but the configuration."""
        last = damping[over] == 0.0
        over, p = over[last], p[last]
        if len(over):
            done.q[over] = self._allowed(self.cost.moved(done.q[over], p), times[over])

    def _steps(
        self, done: _Frames, left: Indices, damping: Array, seen: Seen
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

    def _fitted(self, done: _Frames, damping: Array, times: Array) -> Fit:
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


class LoopRows:
    """Rows of positions that hold whatever force that takes.

    Args:
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
        """Conditions of closed rows for a quadratic program.

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
        slopes = np.empty((len(q), len(self.names), G.shape[2]))
        for i, (one, t) in enumerate(zip(q, times.tolist(), strict=True)):
            self._k.refresh(one, self._rest, Reads.JACOBIAN)
            slopes[i] = self._rows.jacobian(self._k, State(t, one, self._rest)) @ G[i]
        return slopes


class Chart(Protocol):
    """Configurations by independent coordinates."""

    def moved(self, q: Array, dy: Array) -> Array:
        """Configurations after moves of the independent coordinates, (N, nq) and (N, ny)."""

    def tangent(self, q: Array) -> Array:
        """G = dq/dy, shape (N, nv, ny)."""
