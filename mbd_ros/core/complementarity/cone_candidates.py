"""All answers that one contact with friction may have.

Where the point slips, alpha of `cone_contact` is a root of a polynomial of degree four. Source:
O. Bonnefon, G. Daviet, Quartic formulation of Coulomb 3D frictional contact, INRIA RT-0400, 2011.
"""

import math
from collections.abc import Iterator

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import SolveError

Rows = list[list[float]]
EXACT, _ACCEPTED = 1.0e-14, 1.0e-11  # residual of an answer, relative to the p that ends w
_DOUBLE = 1.0e-5  # imaginary share of a root that may be one of two real ones that coincide
_CORRECTIONS = 50
_LARGE = 1.0e12  # impulses, relative to that size
_NO_MOBILITY = 1.0e-100  # 0, but for what it divides
_LEAST, _HALVINGS = 1.0e-20, 70  # the range of an alpha, and of its logarithm
_CORRECT = 1.0e-16  # relative step after which nothing changes


def every_answer(A: Array, b: Array, mu: float, least: float, slack: float) -> Array:
    """As `cone_contact`, by way of all candidates and with every rank decided."""
    values, directions = np.linalg.eigh(A)
    if values[0] <= redundant(3) * values[2]:
        moved = directions[:, values > redundant(3) * values[2]]
        answered = moved.dot(moved.T.dot(b))
        if np.abs(b - answered).max() <= _ACCEPTED * np.abs(b).max() + slack:
            b = answered
    given, rates = A.tolist(), b.tolist()
    size, found, smallest = size_of(given, rates, least), np.zeros(3), math.inf
    for p in _answers(A, b, mu, least):
        left = residual(given, rates, p.tolist(), mu, least)
        if np.abs(p).max() > _LARGE * size:  # it rounds what is left
            continue
        if left <= EXACT * size:
            return p
        if left < smallest:
            found, smallest = p, left
    if smallest <= _ACCEPTED * size + slack / float(A[0, 0]):
        return found
    raise SolveError(f"no impulse of a contact with friction {mu:g} answers {b.tolist()}")


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
    p = disc.whole(alpha)
    size = math.hypot(*p)
    return p if size <= most else p * (most / size)


def _answers(A: Array, b: Array, mu: float, least: float) -> Iterator[Array]:
    """Candidates, in the order of preference."""
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
        """The p along the axes, shape (2,)."""
        pairs = zip(self._c, self._s, strict=True)
        return np.array([-c / max(s + alpha, _NO_MOBILITY) if c else 0.0 for c, s in pairs])

    def whole(self, alpha: float) -> Array:
        """The p, shape (2,)."""
        return self.axes.dot(self.at(alpha))

    def slope(self, alpha: float) -> Array:
        """Derivative of `at` by alpha, shape (2,)."""
        pairs = zip(self._c, self._s, strict=True)
        return np.array([c / max(s + alpha, _NO_MOBILITY) ** 2 if c else 0.0 for c, s in pairs])

    def root(self, most: float) -> float:
        """The alpha > 0 with |p| = most < |p(0)|: Newton's method on 1 / |p|, safe in a bracket.

        Source: J. Moré, D. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553.
        """
        low, high = 0.0, math.hypot(*self._c) / most
        alpha = 0.0
        for _ in range(_CORRECTIONS):
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
        """The alpha >= 0 with |p| = mu (ahead + along . p), the smallest first."""
        scale = self._s[1] or math.hypot(*self._c)
        if scale == 0.0:
            return
        (s1, s2), (c1, c2) = ((x / scale, y / scale) for x, y in (self._s, self._c))
        one, other = np.array((1.0, s1)), np.array((1.0, s2))
        product = np.convolve(one, other)
        normal = ahead * product
        normal[1:] -= along[0] * c1 * other + along[1] * c2 * one
        quartic = c1 * c1 * np.convolve(other, other) + c2 * c2 * np.convolve(one, one)
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
        """A root without the rounding of the polynomial."""
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
    """How far p is from its projection after a step against w: 0 for answers alone."""
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
    """Size of the impulses that can be meant."""
    return max(max(map(abs, b)) / A[0][0], least)
