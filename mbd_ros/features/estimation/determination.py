"""Whether what is measured determines the rest of a mechanism, and when it ceases to.

Velocities of a mechanism with rows keep J v = 0. With measured coordinates m and others u,
J_u v_u = -J_m v_m: where J_u loses rank, at a dead centre, the others are no function of the
measured ones, and multipliers, by J_u' lam = (M a + h - tau)_u, are not determined either.
Source: C. Gosselin, J. Angeles, IEEE Trans. Robotics Automation 6(3) (1990), on these
singularities.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY

_SAMPLES = 8  # of the path that is looked at
_HALVINGS = 10
_PAIR = 2  # rows of a planar loop
_BLIND = 1.0e12  # of amplifications that are shown


class Determinations:
    """Looks at the rows of a system along its way.

    Args:
        measured: Joints that are measured.
        ahead: Time that is looked ahead [s].
        limit: Amplification that counts as singular.

    Attributes:
        asks: Whether there is anything to ask: rows, and coordinates that are not measured.
    """

    def __init__(
        self, system: System, measured: Sequence[str], ahead: float = 0.05, limit: float = 100.0
    ) -> None:
        self._system, self._ahead, self._limit = system, ahead, limit
        nv = system.nv
        lifted = system.expand(State(0.0, system.reduce(_neutral(system)).q, np.zeros(nv)))
        is_known = np.zeros(nv, dtype=np.bool_)
        for name in measured:
            v = system.robot.joint(name).v
            is_known = is_known | _moves(system, lifted, v)
        self._known, self._others = np.flatnonzero(is_known), np.flatnonzero(~is_known)
        self.asks = bool(system.held.rows) and len(self._others) > 0
        self._times = np.linspace(0.0, ahead, _SAMPLES + 1)[1:].tolist()

    def at(self, y: State, a: Array) -> Determination:
        """Determination at a state and on its way.

        Args:
            y: State of what is integrated.
            a: Its accelerations, shape (nv,).
        """
        if not self.asks:
            return Determination(0.0, 1.0, np.inf)
        J = self._rows(y)
        here, condition = self._amplified(J)
        if here > self._limit:
            return Determination(min(here, _BLIND), condition, 0.0)
        size = self._size(J)
        floor = abs(size) * here / self._limit  # amplifications grow as this falls
        before = 0.0
        for t in self._times:
            if self._is_beyond(y, a, t, size, floor):
                return Determination(
                    here, condition, self._crossing(y, a, (before, t), size, floor)
                )
            before = t
        return Determination(here, condition, np.inf)

    def _crossing(
        self, y: State, a: Array, between: tuple[float, float], size: float, floor: float
    ) -> float:
        """The first time between two at which rows are singular [s]."""
        low, high = between
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if self._is_beyond(y, a, middle, size, floor):
                high = middle
            else:
                low = middle
        return high

    def _is_beyond(self, y: State, a: Array, t: float, size: float, floor: float) -> bool:
        there = self._size(self._rows(self._moved(y, a, t)))
        return there * np.sign(size) < floor

    def _moved(self, y: State, a: Array, t: float) -> State:
        q = self._system.chart.integrate(y.q, t * y.v + 0.5 * t * t * a)
        return y._replace(t=y.t + t, q=q)

    def _rows(self, y: State) -> Array:
        """Independent rows, by what is known and by the others."""
        return self._system.held.jacobian(y.t, y.q)

    def _amplified(self, J: Array) -> tuple[float, float]:
        sizes = np.linalg.norm(J, axis=1, keepdims=True)
        J = J / np.maximum(sizes, TINY)
        others = J[:, self._others]
        values = np.linalg.svd(others, compute_uv=False)
        least = float(values[: len(self._others)][-1]) if len(values) else 0.0
        condition = float(np.linalg.norm(J, 2)) / max(least, TINY)
        reply = np.linalg.lstsq(others, J[:, self._known], rcond=None)[0]
        length = float(np.abs(reply).max(initial=0.0)) if least > 0.0 else _BLIND
        return length, min(condition, _BLIND)

    def _size(self, J: Array) -> float:
        """A measure that is 0 where rows are singular; it changes its sign where that can be."""
        others = J[:, self._others]
        m, n = others.shape
        if m == n == _PAIR:
            (a, b), (c, d) = others.tolist()
            return float(a * d - b * c)
        if m == n:
            return float(np.linalg.det(others))
        return float(np.linalg.svd(others, compute_uv=False)[: min(m, n)][-1])


def _neutral(system: System) -> State:
    robot = system.robot
    return State(0.0, robot.neutral(), np.zeros(robot.model.nv))


def _moves(system: System, x: State, v: int) -> NDArray[np.bool_]:
    """Which coordinates of what is integrated a joint goes by, shape (nv,) of bool."""
    found = np.zeros(system.nv, dtype=np.bool_)
    y = system.reduce(x)
    for i, unit in enumerate(np.eye(system.nv)):
        found[i] = system.expand(y._replace(v=unit)).v[v] != 0.0
    return found


class Determination(NamedTuple):
    """How well what is measured determines the rest.

    Attributes:
        amplification: Largest change of a coordinate that is not measured, by a change of length
            one of those that are.
        of_multipliers: Condition number of the rows by what is not measured: the factor by which
            errors of forces grow.
        time: Until a singular configuration on the way that the mechanism goes [s]; inf without
            one within the time that is looked ahead.
    """

    amplification: float
    of_multipliers: float
    time: float
