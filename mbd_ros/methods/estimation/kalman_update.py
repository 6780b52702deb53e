"""Measurement update of a Gaussian belief.

    S = H P H' + R,   K = P H' S^-1,   d = K e,   P+ = (1 - K H) P (1 - K H)' + K R K'

d is a tangent step at the predicted state x-, so the corrected state is x+ = x- (+) d. The
residual is e = y - h(x-); where the update is iterated about a state x_i, it is e = y - h(x_i) +
H (x_i (-) x-). `KalmanFilter.correct` takes these steps. Source: B. D. O. Anderson, J. B.
Moore, Optimal Filtering, 1979, ch. 3; P. D. Joseph's form keeps P symmetric and positive, R. S.
Bucy, P. D. Joseph, 1968.
"""

from typing import NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

Bools = NDArray[np.bool_]


class Innovation(NamedTuple):
    """Difference between a measurement and its prediction.

    Attributes:
        values: Measured minus predicted values, NaN where nothing was measured, shape (m,).
        covariance: Expected covariance of all values, measured or not, shape (m, m).
        used: Which values the update used, shape (m,).
        squared: values' covariance^-1 values of the used ones. If the model is right, it has a
            chi-squared distribution with `freedom` degrees of freedom.
    """

    values: Array
    covariance: Array
    used: Bools
    squared: float

    @property
    def freedom(self) -> int:
        """Number of values that the update used."""
        return int(np.count_nonzero(self.used))

    @property
    def normalized(self) -> Array:
        """Values over their expected standard deviation, NaN where not measured, shape (m,)."""
        deviation = np.sqrt(self.covariance.diagonal())
        return np.asarray(self.values / deviation, dtype=np.float64)


class Update(NamedTuple):
    """Correction of a belief by a measurement.

    Attributes:
        step: Tangent step of the state, shape (n,).
        P: Covariance after the measurement, shape (n, n).
        innovation: Innovation of the measurement.
    """

    step: Array
    P: Array
    innovation: Innovation


def compute_update(
    P: Array,
    H: Array,
    R: Array,
    error: Array,
    used: Bools | None = None,
) -> Update:
    """Compute the state step and the covariance after a measurement.

    Args:
        P: Covariance before the measurement, shape (n, n).
        H: Derivative of the measurement with respect to a tangent step, shape (m, n).
        R: Covariance of the measurement noise, shape (m, m).
        error: Measured minus predicted values, NaN where nothing was measured, shape (m,).
        used: Which values the update may use, shape (m,); all by default.

    Raises:
        SolveError: S is not positive definite.
    """
    expected = H.dot(P).dot(H.T) + R
    counts = np.isfinite(error) if used is None else used & np.isfinite(error)
    if not counts.any():
        return Update(np.zeros(len(P)), P, Innovation(error, expected, counts, 0.0))
    rows, noise, e, S = H, R, error, expected
    if not counts.all():
        chosen = np.ix_(counts, counts)
        rows, noise, e, S = H[counts], R[chosen], error[counts], expected[chosen]
    factor = eigenpy.LLT(S)
    if factor.info() != eigenpy.ComputationInfo.Success:
        raise SolveError(
            "the covariance of the innovation is not positive definite; give sensors a noise > 0"
        )
    K = factor.solve(rows.dot(P)).reshape(len(e), -1).T
    reduction = np.eye(len(P)) - K.dot(rows)
    after = reduction.dot(P).dot(reduction.T) + K.dot(noise).dot(K.T)
    squared = float(e.dot(factor.solve(e).ravel()))
    innovation = Innovation(error, expected, counts, squared)
    return Update(K.dot(e), 0.5 * (after + after.T), innovation)
