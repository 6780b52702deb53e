"""Rows besides the couplings, frame by frame, as a fit of configurations needs them."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.multiplier_laws import Level
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import BRANCH_STEP, LANDED

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
