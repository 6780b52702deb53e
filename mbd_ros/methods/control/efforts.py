"""Efforts for desired accelerations, and accelerations within motion limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.robot import Joint
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import NEARLY_SINGULAR, TINY
from mbd_ros.errors import ModelError, SolveError

_SUCCESS = eigenpy.ComputationInfo.Success
_IDLE_COST = 1.0e-2  # relative to the cost of the least mobile direction
_RESERVE = 2.0  # times the braking acceleration, to compensate for the constant effort of a period


class MobilityFactor:
    """Solves A tau = a for a mobility A, symmetric and positive semidefinite.

    A Cholesky factor serves a regular A. Otherwise, with more drives than freedoms or near a
    toggle, the eigenvectors v_i of A decide:

        tau = sum of v_i (v_i' a) / l_i  over  l_i > 1e-9 l_max

    This is the effort of least norm whose acceleration is nearest to a. Components of a that no
    effort can produce are ignored, instead of causing huge efforts.

    Args:
        mobility: A [acceleration per effort], shape (n, n).

    Attributes:
        is_regular: Whether efforts can produce every acceleration.

    Raises:
        SolveError: A is not finite.

    Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, sec. 5.5.2
        (truncated pseudo-inverse).
    """

    def __init__(self, mobility: Array) -> None:
        self._cholesky = eigenpy.LLT(mobility)
        self.is_regular = bool(
            self._cholesky.info() == _SUCCESS and self._cholesky.rcond() > NEARLY_SINGULAR
        )
        if self.is_regular:
            return
        if not np.isfinite(mobility).all():
            raise SolveError("the mobility of the controlled joints is not finite")
        solver = eigenpy.SelfAdjointEigenSolver(mobility)
        values, vectors = solver.eigenvalues(), solver.eigenvectors()
        kept = values > NEARLY_SINGULAR * values[-1]
        self._values, self._vectors = values[kept], vectors[:, kept]

    def solve(self, a: Array) -> Array:
        """Return the efforts for accelerations, shape (n,), or for one acceleration a column."""
        if self.is_regular:
            return self._cholesky.solve(a).reshape(a.shape)  # eigenpy has its own for n = 1
        return (self._vectors / self._values).dot(self._vectors.T.dot(a))

    def reachable(self, a: Array) -> Array:
        """Return the part of accelerations that efforts can produce, shape (n,)."""
        return a if self.is_regular else self._vectors.dot(self._vectors.T.dot(a))


class TrackingMetric:
    """The weighted squared error at one mobility.

        min |a - a_ref|²_W = sum weight (a_free + mobility tau - a_ref)²

    Every effort is tau = efforts(a_ref - a_free) + T y; y is the error beyond the least one, in
    the root of its weight, and the squared error grows by |y|². Where the mobility is singular
    (redundant actuation), the effort of the least norm is taken. Efforts that move nothing cost a
    hundredth of the least mobile direction, so that limits use them first.

    Args:
        mobility: Symmetric, positive semidefinite, shape (n, n).
        weight: > 0, shape (n,).

    Raises:
        SolveError: The mobility is not finite.
    """

    def __init__(self, mobility: Array, weight: Array) -> None:
        self._factor = MobilityFactor(mobility)
        self._root = np.sqrt(weight)
        if not self._factor.is_regular:
            values, vectors = np.linalg.eigh(mobility)
            moves = values > NEARLY_SINGULAR * values[-1]
            self._moving, self._idle = vectors[:, moves], vectors[:, ~moves]
            image = self._root[:, None] * self._moving * values[moves]
            self._Q, self._R = np.linalg.qr(image)

    def efforts(self, a: Array) -> Array:
        """Return the efforts of least norm that add accelerations best [N·m or N].

        Args:
            a: One acceleration a column [rad/s^2 or m/s^2], shape (n, k).

        Returns:
            Shape (n, k).
        """
        if self._factor.is_regular:
            return self._factor.solve(a)
        target = self._Q.T.dot(self._root[:, None] * a)
        return self._moving.dot(np.linalg.solve(self._R, target))

    def directions(self) -> Array:
        """Return T, shape (n, n)."""
        if self._factor.is_regular:
            return self._factor.solve(np.diag(1.0 / self._root))
        least = np.abs(self._R.diagonal()).min(initial=np.inf)
        cost = _IDLE_COST * float(least) if len(self._R) else 1.0
        active = self._moving.dot(np.linalg.inv(self._R))
        return np.hstack([active, self._idle / cost])


class MotionLimits:
    """Bounds of joint accelerations that follow from position and velocity limits.

    An acceleration a is constant for a horizon h. With the distance d to a position limit and the
    velocity v towards it, it is allowed if the joint can still be stopped at the limit with its
    braking acceleration B afterwards, and does not pass it before:

        (v + h a)² <= 2 B (d - h v - h² a / 2)   where it still moves towards the limit then
        v² <= -2 a d                             where it stops before
        v + h a <= v_max

    A joint within its limits stays within, with decelerations of at most B, if a is exactly
    constant. A constant effort does not quite achieve this, which up to 2 B compensate. A joint
    beyond a limit returns with at most 2 B, at a velocity proportional to its distance beyond.
    Source: A. Del Prete, IEEE Robotics and Automation Letters 3(1), 281-288 (2018),
    doi:10.1109/LRA.2017.2738321. Whether the drives can brake with B is not considered.

    Args:
        joints: Joints; those without limits of the chosen kinds are ignored.
        horizon: h [s], > 0; at least the period of the commands. Drives that need longer to turn
            their torque round need a longer one.
        braking: Time from the largest velocity to rest [s], >= horizon: B is the largest velocity
            over it; without a velocity limit, the range over its square.
        margin: Distance to keep from position limits [rad or m], >= 0.
        position: Whether position limits are kept.
        velocity: Whether velocity limits are kept.

    Attributes:
        joints: Joints that are limited.
        has_position: Which of them have a position limit that is kept, shape (k,).
        has_velocity: Same of velocity limits.

    Raises:
        ModelError: A value that is not accepted, or a margin wider than half a range.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        *,
        horizon: float,
        braking: float,
        margin: float,
        position: bool,
        velocity: bool,
    ) -> None:
        _check(horizon, braking, margin)
        self.joints = tuple(joint for joint in joints if _is_limited(joint, position, velocity))
        lower, upper, fastest = (
            np.array([getattr(joint, name) for joint in self.joints], dtype=np.float64)
            for name in ("lower", "upper", "max_velocity")
        )
        self._q = np.array([joint.q for joint in self.joints], dtype=np.intp)
        self._v = np.array([joint.v for joint in self.joints], dtype=np.intp)
        span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        most = np.where(np.isfinite(fastest), fastest / braking, span / braking**2)
        self.has_position = position & (np.isfinite(lower) | np.isfinite(upper))
        self.has_velocity = velocity & np.isfinite(fastest)
        narrow = self.has_position & ~(upper - lower > 2.0 * margin)
        if narrow.any():
            joint = self.joints[int(narrow.argmax())]
            raise ModelError(
                f"position_margin {margin:g} leaves nothing of the range of {joint.name}, "
                f"{joint.lower:g} to {joint.upper:g}"
            )
        ends = np.where(self.has_position, np.stack([upper, -lower]) - margin, np.inf)
        self._ends, self._fastest = ends, np.where(self.has_velocity, fastest, np.inf)
        self._B, self._h, self._braking = most, horizon, braking

    def box(self, x: State) -> AccelerationBox:
        """Return the bounds at a state of all joints."""
        h, B = self._h, self._B
        q, v = x.q[self._q], x.v[self._v]
        towards = np.stack([v, -v])  # its upper limits, and the mirror image of its lower ones
        d = self._ends - np.stack([q, -q])
        before_stop = 2.0 * d - h * towards
        root = np.sqrt(h * h * B * B + 4.0 * B * np.maximum(before_stop, 0.0)) - B * h
        stop = -0.5 * towards * towards / np.maximum(d, TINY)
        back = (-np.minimum(-d / self._braking, self._fastest) - towards) / h
        within = np.where(d > 0.0, stop, back)
        at_position = np.where(before_stop >= 0.0, (0.5 * root - towards) / h, within)
        at_position = np.maximum(at_position, -_RESERVE * B)
        at_speed = np.maximum((self._fastest - towards) / h, -_RESERVE * B)
        high, low = np.minimum(at_position, at_speed)
        low = -low
        between = 0.5 * (low + high)
        is_crossed = low > high  # too fast for so narrow a range
        low, high = np.where(is_crossed, between, low), np.where(is_crossed, between, high)
        above, below = at_position <= at_speed
        return AccelerationBox(low, high, below, above)


def _check(horizon: float, braking: float, margin: float) -> None:
    if not 0.0 < horizon < np.inf:
        raise ModelError(f"horizon {horizon:g} s must be finite and > 0")
    if not horizon <= braking < np.inf:
        raise ModelError(f"braking {braking:g} s must be finite and >= the horizon, {horizon:g} s")
    if not 0.0 <= margin < np.inf:
        raise ModelError(f"position_margin {margin:g} must be finite and >= 0")


def _is_limited(joint: Joint, position: bool, velocity: bool) -> bool:
    is_bounded = np.isfinite(joint.lower) or np.isfinite(joint.upper)
    return bool((position and is_bounded) or (velocity and np.isfinite(joint.max_velocity)))


class AccelerationBox(NamedTuple):
    """Bounds of joint accelerations over the horizon.

    Attributes:
        lower: Lower bounds [rad/s^2 or m/s^2], shape (k,).
        upper: Upper bounds [rad/s^2 or m/s^2], shape (k,).
        position_below: Whether the lower bound follows from the position limit, shape (k,).
        position_above: Whether the upper bound follows from the position limit, shape (k,).
    """

    lower: Array
    upper: Array
    position_below: NDArray[np.bool_]
    position_above: NDArray[np.bool_]
