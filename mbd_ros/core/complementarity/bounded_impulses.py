"""Impulses of rows that give way, each between two bounds.

    w = A p + b,   lower <= p <= upper,
    w = 0 inside the bounds, w >= 0 at the lower one, w <= 0 at the upper one

w are rates of the rows after the impulses. `push_impulses` solves for rows that only push.
"""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.optimization.box_qp import BoxQp, exchanged
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, HELD_BY_ROWS, TINY
from mbd_ros.errors import SolveError


class BoundedImpulses:
    """Solves the problem above for one configuration.

    Rows that nothing moves exert what their bounds say, and change nothing.

    Args:
        A: Rates that impulses add, symmetric, shape (m, m).
        loose: Diagonal of A while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
    """

    def __init__(self, A: Array, loose: Array, names: Sequence[str]) -> None:
        self._names, diagonal = names, A.diagonal()
        self._mobile = diagonal > HELD_BY_ROWS * loose
        self._unit = 1.0 / np.sqrt(diagonal[self._mobile])
        self._length = np.sqrt(np.where(loose > 0.0, loose, 1.0))
        A = self._unit[:, None] * A[np.ix_(self._mobile, self._mobile)] * self._unit
        self._A = 0.5 * (A + A.T)

    def solve(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """The impulses, shape (m,), fresh.

        Args:
            b: Rates without them, shape (m,).
            lower: Smallest impulses, shape (m,).
            upper: Largest ones, shape (m,).
            speed: Velocity in the mass metric, which no scaled rate exceeds by much.

        Raises:
            SolveError: Nothing keeps a row from moving as it must not; names it.
        """
        p = self._unmoved(b, lower, upper, speed)
        mobile, b = self._mobile, self._unit * b[self._mobile]
        size = max(float(np.abs(b).max(initial=0.0)), speed, TINY)
        unit = size * self._unit
        bounds = lower[mobile] / unit, upper[mobile] / unit
        p[mobile] = unit * self._scaled(b / size, *bounds)
        return p

    def _scaled(self, b: Array, lower: Array, upper: Array) -> Array:
        p = exchanged(self._A, b, lower, upper)
        if p is None:
            p = BoxQp(len(b), rungs=("cold", "damped")).solve(self._A, b, lower, upper)
        return p

    def _unmoved(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """Impulses of rows that nothing moves; 0 for the others."""
        p = np.zeros(len(b))
        if self._mobile.all():
            return p
        b = np.where(self._mobile | (np.abs(b) <= CONTRADICTION * self._length * speed), 0.0, b)
        p = np.where(b < 0.0, upper, np.where(b > 0.0, lower, p))
        if not np.isfinite(p).all():
            name = self._names[int(np.isfinite(p).argmin())]
            raise SolveError(f"nothing can keep constraint row {name} from closing")
        return p
