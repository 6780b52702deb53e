"""One contact with friction, exactly: the laws of Signorini and Coulomb at one point.

    w = A p + b,   p_n >= least,   w_n >= 0,   (p_n - least) w_n = 0
    |p_t| <= mu p_n,   w_t = -alpha p_t,   alpha >= 0,   alpha = 0 where |p_t| < mu p_n

p are impulses or forces of a normal and two tangents, w velocities or accelerations. The cone is
round, no pyramid. Where the point slips, alpha is a root of a polynomial of degree four.
Source: O. Bonnefon, G. Daviet, Quartic formulation of Coulomb 3D frictional contact, INRIA
RT-0400, 2011.
"""

import math
from collections.abc import Iterator

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import SolveError

_EXACT, _ACCEPTED = 1.0e-14, 1.0e-11  # residual of an answer, relative to the p that ends w
_DOUBLE = 1.0e-5  # imaginary share of a root that may be one of two real ones that coincide
_CORRECTIONS = 50
_CORRECT = 1.0e-16  # relative step after which nothing changes


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
    values, directions = np.linalg.eigh(A)
    if values[0] <= redundant(3) * values[2]:
        moved = directions[:, values > redundant(3) * values[2]]
        b = moved.dot(moved.T.dot(b))
    size, found, smallest = _size(A, b, least), np.zeros(3), math.inf
    for p in _answers(A, b, mu, least):
        left = _residual(A, b, p, mu, least)
        if left <= _EXACT * size:
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
        c: Shape (2,); along directions that S does not move it is rounding.
        size: Of the terms that S is the difference of.

    Attributes:
        axes: The principal axes, one a column.
    """

    def __init__(self, S: Array, c: Array, size: float) -> None:
        s, self.axes = np.linalg.eigh(S)
        moves = s > redundant(2) * size
        self._s = np.where(moves, s, 0.0).tolist()
        self._c = np.where(moves, self.axes.T.dot(c), 0.0).tolist()

    def at(self, alpha: float) -> Array:
        """The p along the axes, shape (2,)."""
        pairs = zip(self._c, self._s, strict=True)
        return np.array([-c / (s + alpha) if c else 0.0 for c, s in pairs])

    def whole(self, alpha: float) -> Array:
        """The p, shape (2,)."""
        return self.axes.dot(self.at(alpha))

    def slope(self, alpha: float) -> Array:
        """Derivative of `at` by alpha, shape (2,)."""
        pairs = zip(self._c, self._s, strict=True)
        return np.array([c / (s + alpha) ** 2 if c else 0.0 for c, s in pairs])

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
        scale = self._s[1]
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


def _residual(A: Array, b: Array, p: Array, mu: float, least: float) -> float:
    """How far p is from its projection after a step against w: 0 for answers alone."""
    if not np.isfinite(p).all():
        return math.inf
    w = A.dot(p) + b
    size = float(A.diagonal().max())
    normal = max(float(p[0] - w[0] / A[0, 0]), least)
    pushed = p[1:] - w[1:] / size
    length, most = math.hypot(*pushed), mu * max(float(p[0]), 0.0)
    if length > most:
        pushed *= most / length
    return max(abs(float(p[0]) - normal), float(np.abs(p[1:] - pushed).max()))


def _size(A: Array, b: Array, least: float) -> float:
    """Size of the impulses that can be meant."""
    return max(float(np.abs(b).max()) / float(A[0, 0]), least)
