"""Efforts that give accelerations, and the error that limits add to the accelerations.

min |a - a_ref|²_W = sum weight (a_free + mobility tau - a_ref)²
"""

import numpy as np

from mbd_ros.core.control.mobility_factor import MobilityFactor
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import NEARLY_SINGULAR

_IDLE_COST = 1.0e-2  # of that of the least mobile direction


class TrackingMetric:
    """The weighted squared error at one mobility.

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
        """Those that add accelerations best, of least norm [N·m or N].

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
        """T, shape (n, n)."""
        if self._factor.is_regular:
            return self._factor.solve(np.diag(1.0 / self._root))
        least = np.abs(self._R.diagonal()).min(initial=np.inf)
        cost = _IDLE_COST * float(least) if len(self._R) else 1.0
        active = self._moving.dot(np.linalg.inv(self._R))
        return np.hstack([active, self._idle / cost])
