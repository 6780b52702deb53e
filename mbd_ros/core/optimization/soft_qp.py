"""Which limits act on the smallest vector within them, where some of them yield a little.

min 1/2 |E x|² + 1/2 |e|²   subject to   lower <= (x, C x + sqrt(compliance) e) <= upper
"""

import numpy as np

from mbd_ros.core.optimization.qp_solvers import KeptProxQp
from mbd_ros.core.state import Array


class SoftQp:
    """Hands the problem above to a kept ProxQP, whose multipliers tell which limits act.

    `hard_soft_qp` computes the optimum on these limits, and checks it.

    Args:
        n: Size of x.
        soft: Number of rows of C.
        compliance: How far a row of length one yields to a unit force, > 0.

    Raises:
        ModelError: proxsuite is not installed.
    """

    def __init__(self, n: int, soft: int, compliance: float) -> None:
        size = n + soft
        self._n, self._H, self._g = n, np.zeros((size, size)), np.zeros(size)
        self._soft = np.arange(n, size)
        self._C = np.zeros((soft, size))
        self._C[:, n:] = compliance**0.5 * np.eye(soft)
        self._lower, self._upper = np.full(size, -np.inf), np.full(size, np.inf)
        self._qp = KeptProxQp(size, soft)

    def multipliers(self, E: Array, C: Array, lower: Array, upper: Array, *, cold: bool) -> Array:
        """Those of the bounds, then of the rows; > 0 where the lower limit acts, fresh.

        Args:
            E: Shape (n, n).
            C: Shape (soft, n).
            lower: Shape (n + soft,), in a unit in which they are of the order of 1.
            upper: Same.
            cold: Whether to start from nothing instead of the previous result.
        """
        n, cost = self._n, E.T.dot(E)
        unit = 1.0 / float(cost.diagonal().max())  # its residuals are absolute
        self._H[:n, :n], self._C[:, :n] = unit * cost, C
        self._H[self._soft, self._soft] = unit
        self._lower[:n], self._upper[:n] = lower[:n], upper[:n]
        rows = self._C, lower[n:], upper[n:]
        self._qp.solve(self._H, self._g, self._lower, self._upper, rows, cold=cold)
        z = self._qp.multipliers / unit
        return -np.concatenate([z[len(C) : len(C) + n], z[: len(C)]])
