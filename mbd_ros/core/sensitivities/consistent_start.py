"""States with given values of some joints, the others moved as little as rows demand."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbd_ros.core.projection.assembly import violation
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED, BRANCH_STEP, LANDED
from mbd_ros.errors import SolveError

_MOST = 50


def placed(
    system: Any, y: State, positions: Mapping[int, float], velocities: Mapping[int, float]
) -> State:
    """A consistent state with given positions and velocities.

    The nearest consistent state by masses would give way where a light leg is placed beside a
    heavy trunk; here it is the trunk that follows.

    Args:
        system: The system of its phase.
        y: State of what is integrated; what is not given stays near it.
        positions: Changes of coordinates, by their index in a velocity [rad or m].
        velocities: Values by their index [rad/s or m/s].

    Raises:
        SolveError: The rows of the phase cannot be closed with them.
    """
    step = np.zeros(system.nv)
    for index, change in positions.items():
        step[index] = change
    q, v = system.chart.integrate(y.q, step), y.v.copy()
    for index, value in velocities.items():
        v[index] = value
    if system.held.rows:
        q = _closed(system, y.t, q, np.array([i not in positions for i in range(system.nv)]))
        v = _closing(system, y.t, q, v, np.array([i not in velocities for i in range(system.nv)]))
    y = y._replace(q=q, v=v)
    off = violation(system, y)
    if max(off.position, off.velocity) > ASSEMBLED * (1.0 + float(np.abs(v).max(initial=0.0))):
        raise SolveError("the mechanism cannot be closed with the joints where they are asked for")
    return y


def _closed(system: Any, t: float, q: Array, loose: Array) -> Array:
    """The configuration with closed rows, some coordinates fixed."""
    held = system.held
    for _ in range(_MOST):
        found = np.linalg.lstsq(held.jacobian(t, q)[:, loose], held.residual(t, q))[0]
        longest = float(np.abs(found).max(initial=0.0))
        step = np.zeros(system.nv)
        step[loose] = -found * min(1.0, BRANCH_STEP / max(longest, LANDED))
        q = system.chart.integrate(q, step)
        if longest <= LANDED:
            break
    return q


def _closing(system: Any, t: float, q: Array, v: Array, loose: Array) -> Array:
    """The velocity that keeps the rows closed, some of it fixed."""
    jacobian = system.held.jacobian(t, q)
    off = jacobian.dot(v) + system.held.rate(t, q)
    v[loose] -= np.linalg.lstsq(jacobian[:, loose], off)[0]
    return v
