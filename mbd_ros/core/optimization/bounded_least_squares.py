"""A least-squares problem in a box, with rows that yield: slow, but it always has an answer.

    min 1/2 |E x|² + 1/2 |excess of C x over its limits|² / compliance,   lower <= x <= upper

`hard_soft_qp` falls back on it where ProxQP does not find which limits act.
Source: P. Stark, R. Parker, Computational Statistics 10 (1995), on bounds.
"""

import numpy as np

from mbd_ros.core.optimization.active_set import Sides, passed
from mbd_ros.core.state import Array

COMPLIANCES = (1.0e-2, 1.0e-5, 1.0e-8, 1.0e-11)
_EVENTS = 60  # for each compliance
_PULLS = 1.0e-9  # of the largest slope: one with which a bound holds nothing


class BoundedLeastSquares:
    """The problem above for compliances that fall to the last of `COMPLIANCES`.

    This is a primal active-set method. It goes from one point of the box towards the least cost
    on the bounds that hold and the rows that are passed, up to the first bound or limit.

    Args:
        E: Square, regular, shape (n, n).
        C: Rows that yield, shape (k, n).
        low: Their limits, shape (k,), -inf without one.
        high: Same, inf without one.
    """

    def __init__(self, E: Array, C: Array, low: Array, high: Array) -> None:
        self._E, self._C, self._low, self._high = E, C, low, high
        self._all = np.concatenate([np.eye(len(E)), C])

    def solve(self, lower: Array, upper: Array) -> Array:
        """The x of least cost in the box, or what is left of the way to it, shape (n,)."""
        x = np.clip(np.zeros(len(lower)), lower, upper)
        for compliance in COMPLIANCES:
            x = self._descended(x, lower, upper, compliance**-0.5)
        return x

    def _descended(self, x: Array, lower: Array, upper: Array, stiffness: float) -> Array:
        side = passed(self._C.dot(x), self._low, self._high)
        held = (x <= lower) | (x >= upper)
        for _ in range(_EVENTS):
            r, A = self._residuals(x, side, stiffness)
            step, free = np.zeros(len(x)), (~held).nonzero()[0]
            step[free] = np.linalg.lstsq(A[:, free], -r, rcond=None)[0]
            begin, end = self._pieces(side)
            moves, ends = self._all.dot(step), (np.append(lower, begin), np.append(upper, end))
            share = _way(self._all.dot(x), moves, *ends)
            first = int(share.argmin())
            x = np.clip(x + min(float(share[first]), 1.0) * step, lower, upper)
            if share[first] < 1.0:
                i = first - len(x)
                if i < 0:
                    held[first] = True
                else:
                    side[i] = 0 if side[i] else -np.sign(moves[first])
                continue
            r, A = self._residuals(x, side, stiffness)
            slope = A.T.dot(r)
            pull = np.where(held, np.where(x <= lower, -slope, slope), 0.0)
            pull[lower >= upper] = 0.0
            if pull.max() <= _PULLS * np.abs(slope).max():
                break
            held[pull.argmax()] = False
        return x

    def _residuals(self, x: Array, side: Sides, stiffness: float) -> tuple[Array, Array]:
        rows = side.nonzero()[0]
        limit = np.where(side > 0, self._low, self._high)[rows]
        excess = self._C[rows].dot(x) - limit
        A = np.concatenate([self._E, stiffness * self._C[rows]])
        return np.concatenate([self._E.dot(x), stiffness * excess]), A

    def _pieces(self, side: Sides) -> tuple[Array, Array]:
        """Where the quadratic that each row is on begins and ends."""
        begin = np.where(side == 0, self._low, np.where(side < 0, self._high, -np.inf))
        end = np.where(side == 0, self._high, np.where(side > 0, self._low, np.inf))
        return begin, end


def _way(x: Array, step: Array, begin: Array, end: Array) -> Array:
    """Share of the step that each value may go, inf without an end."""
    ahead = np.where(step > 0.0, end - x, begin - x)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(step == 0.0, np.inf, ahead / step)
    return np.maximum(share, 0.0)
