"""One contact with friction, exactly: the laws of Signorini and Coulomb at one point.

    w = A p + b,   p_n >= least,   w_n >= 0,   (p_n - least) w_n = 0
    |p_t| <= mu p_n,   w_t = -alpha p_t,   alpha >= 0,   alpha = 0 where |p_t| < mu p_n

p are impulses or forces of a normal and two tangents, w velocities or accelerations. The cone is
round, no pyramid. Where the point slips, w_n = 0 leaves (S + alpha) p_t = -c of two tangents, and
Newton's method finds the alpha with |p_t| = mu p_n. Numbers are plain floats: arrays of three cost
ten times as much. Where that finds no answer, `every_answer` tries all candidates: alpha is then a
root of a polynomial of degree four. Source: O. Bonnefon, G. Daviet, Quartic formulation of Coulomb
3D frictional contact, INRIA RT-0400, 2011.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import SolveError

Rows = list[list[float]]
_EXACT = 1.0e-14  # residual of an answer, relative to the p that ends w
_ACCEPTED = 1.0e-11  # the same of the best candidate
_DOUBLE = 1.0e-5  # imaginary share of a root that may be one of two real ones that coincide
_ROOT_STEPS = 50  # of Newton's method for the alpha of largest friction
_LARGE = 1.0e12  # impulses, relative to that size
_NO_MOBILITY = 1.0e-100  # 0, but for what it divides
_LEAST = 1.0e-20  # alpha, of its upper bound, where a bisection of its logarithm begins
_HALVINGS = 70  # of that
_CORRECT = 1.0e-16  # relative step after which nothing changes
_SLIP_STEPS = 40  # of Newton's method for the alpha of a slip
_SAME = 4.0e-16  # relative step after which nothing changes
_FLAT = redundant(2)


def cone_contact(A: Array, b: Array, mu: float, least: float = 0.0, slack: float = 0.0) -> Array:
    """Return p of the problem above, shape (3,); 0 along tangents that nothing moves.

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
    enough = _EXACT * size_of(rows, rates, least)
    if least == 0.0 and rates[0] >= -enough * rows[0][0]:
        return np.zeros(3)
    for p in (_pushes if least == 0.0 else _opens)(rows, rates, mu, least):
        if residual(rows, rates, p, mu, least) <= enough:
            return np.array(p)
    return every_answer(A, b, mu, least, slack)


def _pushes(A: Rows, b: list[float], mu: float, least: float) -> Iterator[list[float]]:
    """Return candidates of a contact that does not open."""
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
        k_1: What friction changes of the normal p.
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
        """Return p along the axes."""
        p_1 = -self.c_1 / (self.s_1 + alpha) if self.c_1 else 0.0
        return p_1, -self.c_2 / (self.s_2 + alpha) if self.c_2 else 0.0

    def root(self) -> float:
        """An alpha with |p_t| = mu p_n: Newton's method on mu p_n / |p_t|, safe in a bracket.

        Source: J. Moré, D. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553.
        """
        s_1, s_2, c_1, c_2, k_1, k_2, ahead, mu = self
        low, high = 0.0, math.hypot(c_1, c_2) * (1.0 / mu + math.hypot(k_1, k_2)) / ahead
        alpha = 0.0
        for _ in range(_SLIP_STEPS):
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


def _opens(A: Rows, b: list[float], mu: float, least: float) -> Iterator[list[float]]:
    """Return candidates of a contact that opens though it pushes with the least p."""
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


def every_answer(A: Array, b: Array, mu: float, least: float, slack: float) -> Array:
    """Solve the same problem as `cone_contact` from all candidates, with every rank decided."""
    values, directions = np.linalg.eigh(A)
    if values[0] <= redundant(3) * values[2]:
        moved = directions[:, values > redundant(3) * values[2]]
        answered = moved.dot(moved.T.dot(b))
        if np.abs(b - answered).max() <= _ACCEPTED * np.abs(b).max() + slack:
            b = answered
    given, rates = A.tolist(), b.tolist()
    size, solution, smallest = size_of(given, rates, least), np.zeros(3), math.inf
    for p in _answers(A, b, mu, least):
        left = residual(given, rates, p.tolist(), mu, least)
        if np.abs(p).max() > _LARGE * size:  # it rounds what is left
            continue
        if left <= _EXACT * size:
            return p
        if left < smallest:
            solution, smallest = p, left
    if smallest <= _ACCEPTED * size + slack / float(A[0, 0]):
        return solution
    raise SolveError(f"no impulse of a contact with friction {mu:g} answers {b.tolist()}")


def _answers(A: Array, b: Array, mu: float, least: float) -> Iterator[Array]:
    """Return candidates, in the order of preference."""
    yield np.concatenate(((least,), friction_at(A[1:, 1:], b[1:] + A[1:, 0] * least, mu * least)))
    n, a = float(A[0, 0]), A[1:, 0]
    ahead = -float(b[0]) / n  # the normal p that ends w_n without friction
    if mu == 0.0:
        yield np.array((ahead, 0.0, 0.0))
        return
    size = float(A.diagonal().max())
    disc = _Tangents(A[1:, 1:] - np.outer(a, a) / n, b[1:] + a * ahead, size)
    along = -disc.axes.T.dot(a) / n
    for alpha in (0.0, *disc.slips(mu, ahead, along)):
        p = disc.at(alpha)
        yield np.concatenate(((ahead + along.dot(p),), disc.axes.dot(p)))


def friction_at(A: Array, b: Array, most: float) -> Array:
    """The p with |p| <= most that pushes against what slips, w = A p + b = -alpha p, shape (2,).

    Args:
        A: Mobility of the tangents, shape (2, 2).
        b: w without p, shape (2,).
        most: Largest friction, >= 0.
    """
    if most <= 0.0:
        return np.zeros(2)
    disc = _Tangents(A, b, float(A.diagonal().max()))
    alpha = 0.0 if math.hypot(*disc.at(0.0)) <= most else disc.root(most)
    p = disc.impulse(alpha)
    size = math.hypot(*p)
    return p if size <= most else p * (most / size)


class _Tangents:
    """The p with (S + alpha) p = -c, along the principal axes of S.

    Args:
        S: Symmetric, positive semidefinite, shape (2, 2).
        c: Shape (2,).
        size: Of the terms that S is the difference of.

    Attributes:
        axes: The principal axes, one a column.
    """

    def __init__(self, S: Array, c: Array, size: float) -> None:
        s, self.axes = np.linalg.eigh(S)
        moves = s > redundant(2) * size
        self._s = np.where(moves, s, 0.0).tolist()
        c = self.axes.T.dot(c)
        is_rounding = np.abs(c) <= _ACCEPTED * np.abs(c).max()
        self._c = np.where(~moves & is_rounding, 0.0, c).tolist()

    def at(self, alpha: float) -> Array:
        """Return p along the axes, shape (2,)."""
        pairs = zip(self._c, self._s, strict=True)
        return np.array([-c / max(s + alpha, _NO_MOBILITY) if c else 0.0 for c, s in pairs])

    def impulse(self, alpha: float) -> Array:
        """Return the p, shape (2,)."""
        return self.axes.dot(self.at(alpha))

    def slope(self, alpha: float) -> Array:
        """Return the derivative of `at` by alpha, shape (2,)."""
        pairs = zip(self._c, self._s, strict=True)
        return np.array([c / max(s + alpha, _NO_MOBILITY) ** 2 if c else 0.0 for c, s in pairs])

    def root(self, most: float) -> float:
        """The alpha > 0 with |p| = most < |p(0)|: Newton's method on 1 / |p|, safe in a bracket.

        Source: J. Moré, D. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553.
        """
        low, high = 0.0, math.hypot(*self._c) / most
        alpha = 0.0
        for _ in range(_ROOT_STEPS):
            p, slope = self.at(alpha), self.slope(alpha)
            size = math.hypot(*p)
            low, high = (alpha, high) if size > most else (low, alpha)
            after = alpha - (size - most) * size * size / (most * float(p.dot(slope)))
            if not low <= after <= high:
                after = 0.5 * (low + high)
            if abs(after - alpha) <= _CORRECT * after:
                break
            alpha = after
        return alpha

    def slips(self, mu: float, ahead: float, along: Array) -> Iterator[float]:
        """Return the alpha >= 0 with |p| = mu (ahead + along . p), the smallest first."""
        scale = self._s[1] or math.hypot(*self._c)
        if scale == 0.0:
            return
        (s1, s2), (c1, c2) = ((x / scale, y / scale) for x, y in (self._s, self._c))
        first, other = np.array((1.0, s1)), np.array((1.0, s2))
        product = np.convolve(first, other)
        normal = ahead * product
        normal[1:] -= along[0] * c1 * other + along[1] * c2 * first
        quartic = c1 * c1 * np.convolve(other, other) + c2 * c2 * np.convolve(first, first)
        quartic = np.concatenate(((0.0, 0.0), quartic)) - mu * mu * np.convolve(normal, normal)
        roots = np.roots(quartic)
        real = roots.real[np.abs(roots.imag) <= _DOUBLE * (np.abs(roots.real) + 1.0)]
        for beta in sorted(real.tolist()):
            if beta >= -_DOUBLE:
                yield self._polished(max(beta, 0.0) * scale, mu, ahead, along)
        if any(c and not s for c, s in zip(self._c, self._s, strict=True)) and ahead > 0.0:
            yield self._bisected(mu, ahead, along)

    def _bisected(self, mu: float, ahead: float, along: Array) -> float:
        """A root where S does not move something that slips: friction is without bound at 0."""
        high = math.hypot(*self._c) * (1.0 / mu + math.hypot(*along.tolist())) / ahead
        low = _LEAST * high
        for _ in range(_HALVINGS):
            alpha = math.sqrt(low) * math.sqrt(high)
            p = self.at(alpha)
            if math.hypot(*p) > mu * (ahead + along.dot(p)):
                low = alpha
            else:
                high = alpha
        return high

    def _polished(self, alpha: float, mu: float, ahead: float, along: Array) -> float:
        """Return a root without the rounding of the polynomial."""
        for _ in range(4):
            p, slope = self.at(alpha), self.slope(alpha)
            size = math.hypot(*p)
            off = size - mu * (ahead + along.dot(p))
            rate = (p.dot(slope) / size if size else 0.0) - mu * along.dot(slope)
            after = alpha - off / rate if rate else alpha
            if not after >= 0.0:
                break
            alpha = after
        return alpha


def residual(A: Rows, b: list[float], p: list[float], mu: float, least: float) -> float:
    """Return how far p is from its projection after a step against w: 0 for answers alone."""
    n, x, y = p
    w_n, w_x, w_y = (
        row[0] * n + row[1] * x + row[2] * y + given for row, given in zip(A, b, strict=True)
    )
    if not math.isfinite(n + x + y):
        return math.inf
    size = max(A[0][0], A[1][1], A[2][2])
    normal = max(n - w_n / A[0][0], least)
    pushed_x, pushed_y = x - w_x / size, y - w_y / size
    length, most = math.hypot(pushed_x, pushed_y), mu * max(n, 0.0)
    if length > most:
        pushed_x, pushed_y = pushed_x * most / length, pushed_y * most / length
    return max(abs(n - normal), abs(x - pushed_x), abs(y - pushed_y))


def size_of(A: Rows, b: list[float], least: float) -> float:
    """Return the size of the impulses that can be meant."""
    return max(max(map(abs, b)) / A[0][0], least)


def cone_residuals(
    A: Array, b: Array, p: Array, mu: float, least: float
) -> tuple[float, float, float, float]:
    """Return what p leaves of the laws: [rate, impulse, impulse, rate], see `Residuals`."""
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
