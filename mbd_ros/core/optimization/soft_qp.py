"""Which limits act on the smallest vector within them, where some of them yield a little."""

from typing import Any

import numpy as np

from mbd_ros.core.optimization.qp import INFINITE, import_proxqp, solve_cold
from mbd_ros.core.state import Array

_TOLERANCE = 1.0e-9  # enough to tell which limits act


class SoftQp:
    """A kept, warm-started ProxQP whose multipliers tell which limits act; whoever asks checks.

        min 1/2 |E x|² + 1/2 |e|²   subject to   lower <= (x, C x + sqrt(compliance) e) <= upper

    Args:
        n: Size of x.
        soft: Number of rows of C.
        compliance: > 0.

    Raises:
        ModelError: proxsuite is not installed.
    """

    def __init__(self, n: int, soft: int, compliance: float) -> None:
        size = n + soft
        self._n, self._H, self._f = n, np.zeros((size, size)), np.zeros(size)
        self._soft = np.arange(n, size)
        self._C = np.zeros((soft, size))
        self._C[:, n:] = compliance**0.5 * np.eye(soft)
        self._lower, self._upper = np.full(size, -INFINITE), np.full(size, INFINITE)
        self._proxqp = import_proxqp()
        self._kept: Any = None

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
        lower, upper = np.maximum(lower, -INFINITE), np.minimum(upper, INFINITE)
        self._lower[:n], self._upper[:n] = lower[:n], upper[:n]
        rows = self._C, lower[n:], upper[n:], self._lower, self._upper
        if cold or self._kept is None:
            self._kept = self._proxqp.dense.QP(len(self._f), 0, len(C), True)
            problem = self._H, self._f, None, None, *rows
            solve_cold(self._proxqp, self._kept, *problem, eps_abs=_TOLERANCE)
        else:
            self._kept.update(self._H, self._f, None, None, *rows)
            self._kept.solve()
        z = np.array(self._kept.results.z) / unit
        return -np.concatenate([z[len(C) : len(C) + n], z[: len(C)]])
