"""A start near the optimum of a separable program, from nothing.

    min sum f_i(x_i)   subject to   A x = b,   lower <= x <= upper

Primal-dual interior point: the conditions of the optimum with z (x - bound) = mu in place of 0,
by Newton's method while mu goes to 0. An unknown with both signs whose f is no smooth function
at 0 is the difference of two that are not negative. Source: S. Mehrotra, SIAM J. Optim. 2 (1992);
S. Wright, Primal-Dual Interior-Point Methods, 1997, ch. 10; J. Nocedal, S. Wright, Numerical
Optimization, 2006, ch. 19.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mbd_ros.core.optimization.separable_cost import Indices, SeparableCost
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY

_STEPS = 80
_TO_BOUND = 0.995  # of the way to the nearest bound
_SMALL = 1.0e-13  # residuals that end it, of the terms
_RIDGE = 1.0e-14  # beside a diagonal of ones


def interior_start(
    cost: SeparableCost, A: Array, b: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """An x near the optimum, and its multipliers; nothing is promised where there is none.

    Args:
        cost: The f.
        A: Shape (m, n), rows of about equal size.
        b: Shape (m,).
        lower: Shape (n,), -inf without a bound.
        upper: Same, > lower.

    Returns:
        x and the lam of A x = b with f' = A' lam between the bounds.
    """
    n, split = A.shape[1], split_at_zero(cost, lower, upper)
    low, high = lower.copy(), upper
    if len(split):
        cost = cost.joined(cost.some(split, -1.0))
        low[split], none = 0.0, np.zeros(len(split))
        low, high = np.concatenate((low, none)), np.concatenate((upper, -lower[split]))
        A = np.concatenate((A, -A[:, split]), axis=1)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        x, lam = _followed(cost, A, b, low, high)
    found = x[:n]
    found[split] -= x[n:]
    return found, lam


def split_at_zero(cost: SeparableCost, lower: Array, upper: Array) -> Indices:
    """Unknowns with both signs whose f is not twice differentiable at 0, as indices."""
    is_split = (lower < 0.0) & (upper > 0.0) & (cost.exponent < 2.0) & (cost.weight > 0.0)
    return is_split.nonzero()[0]


class _Linear(NamedTuple):
    """The conditions, linear about a point."""

    A: Array
    inverse: Array  # of A give A'
    give: Array
    dual: Array
    primal: Array
    below: Array
    above: Array

    def step(self, z: Array, y: Array, to_z: Array, to_y: Array) -> tuple[Array, ...]:
        """Steps of x, lam, z, y by which z (x - lower) changes by to_z, y (upper - x) by to_y."""
        rest = self.dual + to_z / self.below - to_y / self.above
        dlam = self.inverse.dot(self.primal - self.A.dot(self.give * rest))
        dx = self.give * (rest + self.A.T.dot(dlam))
        return dx, dlam, (to_z - z * dx) / self.below, (to_y + y * dx) / self.above


def _followed(
    cost: SeparableCost, A: Array, b: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """The x and lam at the end of the path on which mu goes to 0."""
    is_low, is_high = np.isfinite(lower), np.isfinite(upper)
    bounds = max(int(is_low.sum() + is_high.sum()), 1)
    x, lam = _middle(lower, upper), np.zeros(len(b))
    size = float(np.abs(cost.slope(x)).max(initial=TINY))
    z, y = size * is_low, size * is_high
    for _ in range(_STEPS):
        below, above = np.where(is_low, x - lower, 1.0), np.where(is_high, upper - x, 1.0)
        slope = cost.slope(x)
        dual, primal = A.T.dot(lam) - slope + z - y, b - A.dot(x)
        mu = float(z.dot(below) + y.dot(above)) / bounds
        if _is_small(dual, slope, primal, b, mu):
            break
        give = 1.0 / np.maximum(cost.curvature(x) + z / below + y / above, TINY)
        linear = _Linear(A, _inverse(A, give), give, dual, primal, below, above)
        dx, _, dz, dy = linear.step(z, y, -z * below, -y * above)
        t = _length(((x - lower, dx), (upper - x, -dx), (z, dz), (y, dy)))
        after = (z + t * dz).dot(below + t * dx * is_low)
        after += (y + t * dy).dot(above - t * dx * is_high)
        centre = mu * min(max(after / (bounds * max(mu, TINY)), 0.0), 1.0) ** 3
        to_z = np.where(is_low, centre - z * below - dx * dz, 0.0)
        to_y = np.where(is_high, centre - y * above + dx * dy, 0.0)
        dx, dlam, dz, dy = linear.step(z, y, to_z, to_y)
        if not np.isfinite(dx).all():
            break
        t = _length(((x - lower, dx), (upper - x, -dx), (z, dz), (y, dy)))
        x, lam, z, y = x + t * dx, lam + t * dlam, z + t * dz, y + t * dy
    return x, lam


def _inverse(A: Array, give: Array) -> Array:
    """Inverse of A give A', by way of ones on its diagonal: in the end its rows differ a lot."""
    M = (A * give).dot(A.T)
    diagonal = M.diagonal()
    scale = np.where(diagonal > 0.0, diagonal, 1.0) ** -0.5
    M = scale[:, None] * M * scale
    M.flat[:: len(M) + 1] += _RIDGE
    return np.asarray(scale[:, None] * np.linalg.inv(M) * scale)


def _middle(lower: Array, upper: Array) -> Array:
    """Between the bounds; away from zero, where powers have no curvature, without any."""
    low, high = np.isfinite(lower), np.isfinite(upper)
    return np.where(
        low & high,
        (np.where(low, lower, 0.0) + np.where(high, upper, 0.0)) / 2.0,
        np.where(low, lower + 1.0, np.where(high, upper - 1.0, 0.1)),
    )


def _is_small(dual: Array, slope: Array, primal: Array, b: Array, mu: float) -> bool:
    size = 1.0 + float(np.abs(slope).max(initial=0.0))
    most = 1.0 + float(np.abs(b).max(initial=0.0))
    return bool(
        np.abs(dual).max(initial=0.0) <= _SMALL * size
        and np.abs(primal).max(initial=0.0) <= _SMALL * most
        and mu <= _SMALL * size
    )


def _length(moves: Iterable[tuple[Array, Array]]) -> float:
    """Share of a step that keeps all values positive."""
    reach = 1.0 / _TO_BOUND
    for value, move in moves:
        falls = move < 0.0
        if falls.any():
            reach = min(reach, float((value[falls] / -move[falls]).min()))
    return min(1.0, _TO_BOUND * max(reach, 0.0))
