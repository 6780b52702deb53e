"""Assembly: projection onto the constraint manifold in the mass metric.

    position   min |q - q0|_M   subject to   g(t, q) = 0
    velocity   min |v - v0|_M   subject to   J v + dg/dt = 0

`assemble` accepts any state and returns the nearest one on its branch; `project` corrects a state
that a step took slightly off the manifold, with few evaluations. A `Stabilization` keeps a
simulation on the manifold by projection or by feedback.

Source: E. Eich, Convergence results for a coordinate projection method applied to mechanical
systems with algebraic constraints, SIAM J. Numer. Anal. 30 (1993).
"""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED, BRANCH_STEP, LANDED, NEAREST, ON_MANIFOLD
from mbd_ros.errors import SolveError

_MAX_ITERATIONS = 100  # of Newton's method, and of the descent along the manifold
_SMALLEST_STEP = 1.0e-6  # share of a full step below which the descent ends
_CORRECTIONS = 12  # of positions after a step
_VELOCITY_CORRECTIONS = 3
_SHRINKS = 0.1  # ratio of residuals; slower convergence means that the Jacobian has changed
_STUCK = 4  # largest number of new factorizations
_OPEN = 1.0e-6  # accepted residual of rows at a toggle [m or rad]


def assemble(system: System, x: State) -> State:
    """Return the nearest consistent state on the branch of a state that may be far off.

    A state that is consistent to rounding is returned unchanged, so that runs continue from it.

    Args:
        x: Any finite state of the integrated coordinates.

    Raises:
        SolveError: There is none near x; the message names the worst row and its residual.
    """
    bilateral = system.bilateral
    if not bilateral.rows or _is_consistent(system, x):
        return x
    q = _nearest_configuration(system, x) if system.rows else x.q
    J, rate = bilateral.jacobian(x.t, q), bilateral.rate(x.t, q)
    v, factor = x.v, bilateral.factor_at(x.t, q)
    for _ in range(_VELOCITY_CORRECTIONS):  # redundant rows leave some of the first one's error
        v = _consistent_velocity(v, J, rate, factor)
        left = J.dot(v) + rate
        if float(np.abs(left).max()) <= ON_MANIFOLD * (1.0 + _speed(system, J, v)):
            break
    worst = int(np.argmax(np.abs(left)))
    if not abs(left[worst]) <= ASSEMBLED * (1.0 + _speed(system, J, x.v)):
        raise SolveError(
            f"no consistent velocity: row {bilateral.rows[worst].name} keeps a rate of "
            f"{left[worst]:.3g} per second, since it contradicts other rows; check the constraints"
        )
    return x._replace(q=q, v=v)


def _is_consistent(system: System, x: State) -> bool:
    off = violation(system, x)
    fastest = _speed(system, system.bilateral.jacobian(x.t, x.q), x.v)
    return off.position <= ON_MANIFOLD and off.velocity <= ON_MANIFOLD * (1.0 + fastest)


def _speed(system: System, J: Array, v: Array) -> float:
    """Return the largest velocity [m/s or rad/s], without free bodies that no row involves."""
    if system.robot.bases:
        v = v[J.any(axis=0)]
    return float(np.abs(v).max(initial=0.0))


def _nearest_configuration(system: System, x: State) -> Array:
    """Minimize the distance to the start along the manifold, after Newton's method reached it."""
    M = system.mass(x.q).dense
    landed, step = _close(system, x.t, x.q, M), 1.0
    if landed is None:
        raise _not_assembled(system, x)
    q = landed
    away = system.chart.difference(x.q, q)
    for _ in range(_MAX_ITERATIONS):
        J = system.jacobian(x.t, q)
        factor = RowFactor(M, J)
        downhill = factor.motion(J.dot(away)) - away
        if np.abs(downhill).max() <= NEAREST or step < _SMALLEST_STEP:
            break
        nearer = _close(system, x.t, system.chart.integrate(q, step * downhill), M)
        if nearer is not None:
            distance = system.chart.difference(x.q, nearer)
            if distance.dot(M.dot(distance)) < away.dot(M.dot(away)):
                q, away = nearer, distance
                continue
        step *= 0.5
    return q


def _close(system: System, t: float, start: Array, M: Array) -> Array | None:
    """Solve g = 0 by Newton's method with the smallest steps in the metric M; None if it fails."""
    q = start
    for _ in range(_MAX_ITERATIONS):
        g = system.residual(t, q)
        worst = float(np.abs(g).max())
        if worst <= LANDED:
            return q
        factor = RowFactor(M, system.jacobian(t, q))
        dq = -factor.motion(g)
        largest = float(np.abs(dq).max())
        if not largest > LANDED:
            break
        q = system.chart.integrate(q, dq * min(1.0, BRANCH_STEP / largest))
    return q if float(np.abs(system.residual(t, q)).max()) <= ASSEMBLED else None


def _not_assembled(system: System, x: State) -> SolveError:
    g = np.abs(system.residual(x.t, x.q))
    row = system.rows[int(np.argmax(g))]
    return SolveError(
        f"the mechanism cannot be assembled near this position: row {row.name} is "
        f"{g.max():.3g} m or rad open and does not close; change the initial positions, or check "
        "the constraints for contradictions"
    )


def _consistent_velocity(v: Array, J: Array, rate: Array, factor: RowFactor) -> Array:
    return v - factor.motion(J.dot(v) + rate)


def project(system: System, x: State) -> State:
    """Project a state that is near the constraints onto them, as after every step.

    Positions satisfy the rows of positions, velocities all rows. Dependent rows and rows at a
    toggle are omitted. `system.condition` is updated.

    Raises:
        SolveError: The state is too far away; the message names the time and the violated row.
    """
    if not system.bilateral.rows:
        return x
    try:
        return _project(system, x)
    except SolveError as error:
        raise SolveError(f"at t = {x.t:.9g} s: {error}") from error


def _project(system: System, x: State) -> State:
    bilateral, q, factor = system.bilateral, x.q, None
    if system.rows:
        q, factor = _close_nearby(system, x)
    if factor is None or len(bilateral.rows) > len(system.rows):
        factor = bilateral.factor_at(x.t, q)
    J, rate = bilateral.jacobian(x.t, q), bilateral.rate(x.t, q)
    v, slow = x.v, ON_MANIFOLD * (1.0 + _speed(system, J, x.v))
    for attempt in range(_VELOCITY_CORRECTIONS):
        if attempt == _VELOCITY_CORRECTIONS - 1:  # the factors belong to an earlier configuration
            factor = bilateral.factor_at(x.t, q)
        v = _consistent_velocity(v, J, rate, factor)
        if float(np.abs(J.dot(v) + rate).max()) <= slow:
            break
    return x._replace(q=q, v=v)


def _close_nearby(system: System, x: State) -> tuple[Array, RowFactor]:
    """Close the rows by simplified Newton steps, with new factors where convergence is slow."""
    q, g = x.q, system.residual(x.t, x.q)
    factor = system.factorise(x.t, q)
    last, stuck = float(np.abs(g).max()), 0
    for _ in range(_CORRECTIONS):
        q = system.chart.integrate(q, -factor.motion(g))
        g = system.residual(x.t, q)
        worst = float(np.abs(g).max())
        if worst <= LANDED:
            return q, factor
        if not worst <= _SHRINKS * last:
            stuck += 1
            if worst <= ASSEMBLED or stuck == _STUCK or not worst < np.inf:
                break
            factor = system.factorise(x.t, q)
        last = worst
    if not worst <= _OPEN:
        row = system.rows[int(np.argmax(np.abs(g)))].name
        raise SolveError(
            f"row {row} is {worst:.3g} m or rad open and does not close: the step was too long, "
            "or the measurement does not fit the mechanism"
        )
    return q, factor


class Violation(NamedTuple):
    """Violation of the bilateral constraints.

    Attributes:
        position: Largest |g| [m or rad].
        velocity: Largest |g'| [m/s or rad/s].
    """

    position: float
    velocity: float


def violation(system: System, x: State) -> Violation:
    """Return the violation of the bilateral constraints at a state of integrated coordinates."""
    bilateral = system.bilateral
    if not bilateral.rows:
        return Violation(0.0, 0.0)
    g = bilateral.residual(x.t, x.q)
    rate = bilateral.jacobian(x.t, x.q).dot(x.v) + bilateral.rate(x.t, x.q)
    return Violation(float(np.abs(g).max()), float(np.abs(rate).max()))


class Stabilization:
    """Correction of constraint drift: of accelerations by `gains`, or of states by `correct`.

    Attributes:
        projects: Whether `correct` returns the nearest consistent state in the mass metric;
            compiled runs then do this themselves.
    """

    projects: bool = False

    def gains(self, dt: float) -> tuple[float, float]:
        """Return kp [1/s^2] and kd [1/s] of g'' + kd g' + kp g = 0 for steps of dt [s]."""
        return 0.0, 0.0

    def correct(self, system: System, x: State) -> State:
        """Return the corrected state after a step; x itself if there is nothing to correct."""
        return x
