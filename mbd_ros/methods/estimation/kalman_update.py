"""What a measurement says about a Gaussian belief.

    S = H P H' + R,   K = P H' S^-1,   d = K e,   P+ = (1 - K H) P (1 - K H)' + K R K'

d is a step in the tangent of the manifold at the predicted state x-: the corrected state is x+ =
x- (+) d. The residual e is y - h(x-), and where the update is iterated about a state x_i, e = y -
h(x_i) + H (x_i (-) x-). `KalmanFilter.correct` takes these steps. Source: B. D. O. Anderson, J. B.
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
    """How far a measurement was from its prediction.

    Attributes:
        values: Measured less predicted, NaN where nothing was measured, shape (m,).
        covariance: Expected of them, shape (m, m); of what was not measured, too.
        used: Which of them counted, shape (m,).
        squared: values' covariance^-1 values over what counted: chi-squared distributed with as
            many degrees of freedom where the model is right.
    """

    values: Array
    covariance: Array
    used: Bools
    squared: float

    @property
    def freedom(self) -> int:
        """How many numbers counted."""
        return int(np.count_nonzero(self.used))

    @property
    def normalized(self) -> Array:
        """Values over their expected deviation, NaN where nothing was measured, shape (m,)."""
        deviation = np.sqrt(self.covariance.diagonal())
        return np.asarray(self.values / deviation, dtype=np.float64)


class Update(NamedTuple):
    """What a measurement changes.

    Attributes:
        step: In the tangent, shape (n,).
        P: Covariance afterwards, shape (n, n).
        innovation: What it was found from.
    """

    step: Array
    P: Array
    innovation: Innovation


def updated(
    P: Array,
    H: Array,
    R: Array,
    error: Array,
    used: Bools | None = None,
) -> Update:
    """The step and the covariance after a measurement.

    Args:
        P: Covariance before it, shape (n, n).
        H: Derivative of the measurement, shape (m, n).
        R: Covariance of its noise, shape (m, m).
        error: Measured less predicted, NaN where nothing was measured, shape (m,).
        used: Which numbers may count, shape (m,); all by default.

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
            "the covariance of the innovation is not positive definite: give sensors noise > 0"
        )
    K = factor.solve(rows.dot(P)).reshape(len(e), -1).T
    rest = np.eye(len(P)) - K.dot(rows)
    after = rest.dot(P).dot(rest.T) + K.dot(noise).dot(K.T)
    squared = float(e.dot(factor.solve(e).ravel()))
    innovation = Innovation(error, expected, counts, squared)
    return Update(K.dot(e), 0.5 * (after + after.T), innovation)
