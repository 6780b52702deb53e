"""One contact with friction, exactly: the laws of Signorini and Coulomb at one point.

    w = A p + b,   p_n >= least,   w_n >= 0,   (p_n - least) w_n = 0
    |p_t| <= mu p_n,   w_t = -alpha p_t,   alpha >= 0,   alpha = 0 where |p_t| < mu p_n

p are impulses or forces of a normal and two tangents, w velocities or accelerations. The cone is
round, no pyramid. Where the point slips, w_n = 0 leaves (S + alpha) p_t = -c of two tangents, and
Newton's method finds the alpha with |p_t| = mu p_n. Numbers are plain floats: arrays of three cost
ten times as much. Source: O. Bonnefon, G. Daviet, Quartic formulation of Coulomb 3D frictional
contact, INRIA RT-0400, 2011.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mbd_ros.core.complementarity.cone_candidates import (
    EXACT,
    Rows,
    every_answer,
    residual,
    size_of,
)
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant

_CORRECTIONS = 40
_SAME = 4.0e-16  # relative step after which nothing changes
_FLAT = redundant(2)


def cone_contact(A: Array, b: Array, mu: float, least: float = 0.0, slack: float = 0.0) -> Array:
    """The p of the problem above, shape (3,); 0 along tangents that nothing moves.

    Where friction couples so strongly that there are several answers, a contact that opens comes
    before one that sticks, and that before one that slips.

    Args:
        A: Mobility, symmetric, positive semidefinite, with A_nn > 0, shape (3, 3).
        b: w without p, shape (3,); what A does not move of it is rounding.
        mu: Coefficient of friction, >= 0.
        least: Smallest normal p, >= 0; what an expansion gives back at any rate.
        slack: Rounding of b, where that is known to be a difference of large terms.

    Raises:
        SolveError: No answer passes the check.
    """
    rows: Rows = A.tolist()
    rates: list[float] = b.tolist()
    enough = EXACT * size_of(rows, rates, least)
    if least == 0.0 and rates[0] >= -enough * rows[0][0]:
        return np.zeros(3)
    for p in (_pushes if least == 0.0 else _opens)(rows, rates, mu, least):
        if residual(rows, rates, p, mu, least) <= enough:
            return np.array(p)
    return every_answer(A, b, mu, least, slack)


def cone_residuals(
    A: Array, b: Array, p: Array, mu: float, least: float
) -> tuple[float, float, float, float]:
    """What p leaves of the laws: [rate, impulse, impulse, rate], see `Residuals`."""
    rows: Rows = A.tolist()
    impulses: list[float] = p.tolist()
    normal, x, y = impulses
    w_n, w_x, w_y = (A.dot(p) + b).tolist()
    n, t = rows[0][0], max(rows[1][1], rows[2][2])
    push = max(normal - w_n / n, least)
    correction, over = 0.0, math.hypot(x, y) - mu * normal
    if t > 0.0:
        z_x, z_y = x - w_x / t, y - w_y / t
        length, most = math.hypot(z_x, z_y), mu * push
        share = most / length if length > most else 1.0
        correction = t * math.hypot(x - share * z_x, y - share * z_y)
    return n * abs(normal - push), max(least - normal, 0.0), max(over, 0.0), correction


def _opens(A: Rows, b: list[float], mu: float, least: float) -> Iterator[list[float]]:
    """Candidates of a contact that opens though it pushes with the least p."""
    (_, a_x, a_y), (_, S_xx, S_xy), (_, _, S_yy) = A
    if mu == 0.0:
        yield [least, 0.0, 0.0]
        return
    s_1, s_2, x, y = _axes(S_xx, S_xy, S_yy)
    c_x, c_y, flat = b[1] + a_x * least, b[2] + a_y * least, _FLAT * max(S_xx, S_yy)
    s_1, c_1 = (s_1, x * c_x + y * c_y) if s_1 > flat else (0.0, 0.0)
    s_2, c_2 = (s_2, x * c_y - y * c_x) if s_2 > flat else (0.0, 0.0)
    slip = _Slip(s_1, s_2, c_1, c_2, 0.0, 0.0, least, mu)
    for sticks in (True, False):
        p_1, p_2 = slip.at(0.0 if sticks else slip.root())
        yield [least, x * p_1 - y * p_2, y * p_1 + x * p_2]


def _pushes(A: Rows, b: list[float], mu: float, least: float) -> Iterator[list[float]]:
    """Candidates of a contact that does not open."""
    (n, a_x, a_y), (_, S_xx, S_xy), (_, _, S_yy) = A
    ahead = -b[0] / n  # the normal p that ends w_n without friction
    if mu == 0.0:
        yield [ahead, 0.0, 0.0]
        return
    size = max(n, S_xx, S_yy)
    s_1, s_2, x, y = _axes(S_xx - a_x * a_x / n, S_xy - a_x * a_y / n, S_yy - a_y * a_y / n)
    c_x, c_y = b[1] + a_x * ahead, b[2] + a_y * ahead
    flat = _FLAT * size
    s_1, c_1 = (s_1, x * c_x + y * c_y) if s_1 > flat else (0.0, 0.0)
    s_2, c_2 = (s_2, x * c_y - y * c_x) if s_2 > flat else (0.0, 0.0)
    k_1, k_2 = -(x * a_x + y * a_y) / n, -(x * a_y - y * a_x) / n
    slip = _Slip(s_1, s_2, c_1, c_2, k_1, k_2, ahead, mu)
    for sticks in (True, False):
        p_1, p_2 = slip.at(0.0 if sticks else slip.root())
        yield [ahead + k_1 * p_1 + k_2 * p_2, x * p_1 - y * p_2, y * p_1 + x * p_2]


def _axes(p: float, q: float, r: float) -> tuple[float, float, float, float]:
    """Eigenvalues of ((p, q), (q, r)) and the axis x, y of the first; -y, x is the other one."""
    if q == 0.0:
        return p, r, 1.0, 0.0
    half = 0.5 * (r - p) / q
    t = math.copysign(1.0, half) / (abs(half) + math.hypot(1.0, half))
    x = 1.0 / math.hypot(1.0, t)
    return p - t * q, r + t * q, x, -t * x


class _Slip(NamedTuple):
    """Where alpha has to be found; tangents along their principal axes.

    Attributes:
        s_1: Mobility of the first axis.
        s_2: Of the second one.
        c_1: Rates without friction.
        c_2: The same.
        k_1: What friction changes of the normal p.
        k_2: The same.
        ahead: The normal p without friction.
        mu: Coefficient of friction.
    """

    s_1: float
    s_2: float
    c_1: float
    c_2: float
    k_1: float
    k_2: float
    ahead: float
    mu: float

    def at(self, alpha: float) -> tuple[float, float]:
        """The p along the axes."""
        p_1 = -self.c_1 / (self.s_1 + alpha) if self.c_1 else 0.0
        return p_1, -self.c_2 / (self.s_2 + alpha) if self.c_2 else 0.0

    def root(self) -> float:
        """An alpha with |p_t| = mu p_n: Newton's method on mu p_n / |p_t|, safe in a bracket.

        Source: J. Moré, D. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553.
        """
        s_1, s_2, c_1, c_2, k_1, k_2, ahead, mu = self
        low, high = 0.0, math.hypot(c_1, c_2) * (1.0 / mu + math.hypot(k_1, k_2)) / ahead
        alpha = 0.0
        for _ in range(_CORRECTIONS):
            p_1 = -c_1 / (s_1 + alpha) if c_1 else 0.0
            p_2 = -c_2 / (s_2 + alpha) if c_2 else 0.0
            d_1 = -p_1 / (s_1 + alpha) if c_1 else 0.0
            d_2 = -p_2 / (s_2 + alpha) if c_2 else 0.0
            length, normal = math.hypot(p_1, p_2), ahead + k_1 * p_1 + k_2 * p_2
            if length > mu * normal:
                low = alpha
            else:
                high = alpha
            if length == 0.0:
                break
            slope = length * (k_1 * d_1 + k_2 * d_2) - normal * (p_1 * d_1 + p_2 * d_2) / length
            after = alpha + length * (length / mu - normal) / slope if slope else math.inf
            if not low <= after <= high:
                after = 0.5 * (low + high)
            if abs(after - alpha) <= _SAME * after:
                break
            alpha = after
        return alpha
