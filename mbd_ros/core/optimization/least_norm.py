"""The smallest vector of an affine set that keeps bounds and friction cones.

Bounds alone (`least_in_bounds`):

    z = z0 + N y,   lower <= z <= upper

Among these the entries of the first group have the smallest norm. Among those that attain it the
second group has the smallest, and so on. `methods/inverse_dynamics` asks it of efforts and
multipliers.

Bounds and cones (`least_in_cones`):

    min |A y - c|^2,   y = y0 + N w,   lower <= y <= upper,   |y_t| <= mu y_n

The rows of A are groups, one far heavier than the next: what comes first is as small as it can be,
then what comes next. An interior-point method solves it, with a shift of all limits that is paid
for: where it stays, nothing keeps the limits. Where contacts that do not press exert nothing at
all (`least_with_open`), y_i = 0 for contacts i that are open, and contacts that would pull are
opened one after the other. That answer is the one of all cones where none is left beyond its own,
and every open one would move apart: its price z, with the gradient N' A' (A y - c) = sum of N_i'
z_i, is in the dual cone mu |z_t| <= z_n.

Sources: A. Escande, N. Mansard, P. Wieber, Int. J. Robotics Research 33(7) (2014), on the order;
R. T. Rockafellar, SIAM J. Control Optim. 14 (1976), on the steps that leave later groups free;
S. Boyd, L. Vandenberghe, Convex Optimization, 2004, sec. 11.3 (barrier), 11.4 (start), 11.6 (cones
of second order), 5.5.3 and 5.9 (prices).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.hard_soft_qp import HardSoftQp
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, SINGULAR, redundant
from mbd_ros.errors import SolveError

_LATER = 1.0e-3  # price of a move of later groups, which is paid for the last step alone
_STEPS = 20
_ARRIVED = 1.0e-12  # of the size of z
_KEPT = 1.0e-9  # the same, by which a bound may be passed
_WITHIN = 1.0e-10  # of the largest number: what rounding leaves of a limit that is kept
_PRICED = 1.0e-9  # of the largest price: one that is not negative
_PRICE = 10.0  # of the shift, where numbers are of size one
_FIRST = 1.0  # weight of the barrier
_LAST = 1.0e-16  # the same at the end
_FALL = 0.02  # of the weight, from one to the next
_NEWTON_STEPS = 12  # of Newton's method, for each of them
_CENTRED = 0.1  # decrement at which one is solved
_SHORTENED = 0.95  # of the way to the nearest limit
_HALVINGS = 40  # of a step
_LEAST_DESCENT = 1.0e-4  # of what a step promises
_SHIFTED = 1.0e-7  # of the largest number: a shift that stays


def least_in_bounds(
    z: Array, N: Array, groups: Sequence[slice], lower: Array, upper: Array
) -> Least:
    """Solve the problem above; nothing is kept between calls.

    Args:
        z: z0, shape (n,).
        N: Directions, orthonormal, shape (n, k).
        groups: Entries of z, those that come first in front.
        lower: Shape (n,), -inf without a bound.
        upper: Same, >= lower.

    Raises:
        SolveError: Something is not finite.
        ModelError: proxsuite is not installed.
    """
    every, low, high = N, lower, upper
    for group in groups:
        U, s, Vt = np.linalg.svd(N[group])
        rank = int(np.count_nonzero(s > SINGULAR))
        if rank == 0:
            continue
        own, N = N.dot(Vt[:rank].T / s[:rank]), N.dot(Vt[rank:].T)
        z = z - own.dot(U[:, :rank].T.dot(z[group]))  # from where the group is smallest
        z, is_within = _nearest(z, own, N, low, high)
        if not is_within:
            return Least(z, False)
        low, high = np.minimum(lower, z), np.maximum(upper, z)  # the last digits
    slack = _KEPT * (1.0 + float(np.abs(z).max(initial=0.0)))
    is_within = bool((z >= lower - slack).all() and (z <= upper + slack).all())
    return Least(_refined(z, every, lower, upper, slack) if is_within else z, is_within)


def _nearest(z: Array, columns: Array, later: Array, lower: Array, upper: Array) -> Least:
    """The z + own w + later y within the bounds whose |w| is the least."""
    n = columns.shape[1]
    limited = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if not len(limited):
        return Least(z, True)
    moves = np.concatenate((columns, later / _LATER), axis=1)
    free = np.full(moves.shape[1], np.inf)
    G = np.concatenate((np.eye(len(free)), moves[limited]))
    w, tolerance = np.zeros(n), _ARRIVED * (1.0 + float(np.abs(z).max()))
    for _ in range(_STEPS):
        low = np.concatenate((-free, (lower - z)[limited]))
        high = np.concatenate((free, (upper - z)[limited]))
        solution = HardSoftQp(len(free), len(limited)).solve(G, low, high)
        if solution.is_softened:
            return Least(z + moves.dot(solution.y), False)
        before, w = w, solution.y[:n]
        z_now = z + moves.dot(solution.y)
        if not later.shape[1] or np.abs(w - before).max() <= tolerance:
            break
        z = z + moves[:, n:].dot(solution.y[n:])
    return Least(z_now, True)


def _refined(z: Array, N: Array, lower: Array, upper: Array, slack: float) -> Array:
    """The same without the last digits by which bounds are passed or missed."""
    low, high = z <= lower + slack, z >= upper - slack
    bound, at_bound = np.where(low, lower, np.where(high, upper, z)), low | high
    onto: Any = np.linalg.lstsq(N[at_bound], (bound - z)[at_bound], rcond=SINGULAR)[0]
    return np.clip(z + N.dot(onto), lower, upper)


class Least(NamedTuple):
    """The answer.

    Attributes:
        z: The vector, shape (n,); where the bounds cannot be kept the one with the least excess.
        is_within: Whether it keeps them.
    """

    z: Array
    is_within: bool


def least_in_cones(y: Array, N: Array, A: Array, c: Array, limits: Limits) -> tuple[Array, bool]:
    """Solve the problem above; nothing is kept between calls.

    Args:
        y: y0, shape (n,).
        N: Directions, orthonormal, shape (n, k).
        A: Shape (m, n).
        c: Shape (m,).

    Returns:
        The vector, and whether it keeps the limits.

    Raises:
        SolveError: Something is not finite.
    """
    size = max(float(np.abs(y).max(initial=0.0)), float(np.abs(c).max(initial=0.0)), 1e-300)
    if not np.isfinite(size):
        raise SolveError("forces are not finite")
    quick = least_with_open(y, N, A, c, limits)
    if quick is not None:
        return quick, True
    barrier = _Barrier(y / size, N, limits, size)
    rows = A.dot(N), A.dot(y / size) - c / size
    w, shift = np.zeros(N.shape[1]), barrier.start()
    x, weight = np.append(w, shift), _FIRST
    while weight >= _LAST:
        x = _centred(x, rows, barrier, weight)
        weight *= _FALL
    found: Array = y + size * N.dot(x[:-1])
    return found, bool(x[-1] <= _SHIFTED)


class _Barrier:
    """Logarithms of the room that limits leave, each shifted by the last entry of x.

    Args:
        y: y0, of size one.
        limits: Of y times `size`.
        size: Unit of y.
    """

    def __init__(self, y: Array, N: Array, limits: Limits, size: float) -> None:
        below, above = np.isfinite(limits.lower), np.isfinite(limits.upper)
        lower, upper = limits.lower[below] / size, limits.upper[above] / size
        n = N.shape[1]
        flat = np.ones((int(below.sum() + above.sum()), n + 1))
        flat[:, :n] = np.concatenate((N[below], -N[above]))
        self._flat = flat, np.concatenate((y[below] - lower, upper - y[above]))
        entries = limits.cones.ravel()
        round_ = np.zeros((len(entries), n + 1))
        round_[:, :n] = N[entries]
        round_[::3] *= np.maximum(limits.mu, 1e-12)[:, None]
        round_[::3, n] = 1.0
        at = y[entries].copy()
        at[::3] *= limits.mu
        self._round = round_, at
        self._n = n

    def start(self) -> float:
        """A shift with which y0 has room."""
        rounds = self._round[1].reshape(-1, 3)
        needed = np.hypot(rounds[:, 1], rounds[:, 2]) - rounds[:, 0]
        lacking = max(float(needed.max(initial=0.0)), float((-self._flat[1]).max(initial=0.0)))
        return 1.1 * lacking + 0.1

    def _of(self, x: Array) -> tuple[Array, Array]:
        return self._flat[0].dot(x) + self._flat[1], self._round[0].dot(x) + self._round[1]

    def value(self, x: Array) -> float:
        """The barrier, infinite without room."""
        flat, rounds = self._of(x)
        room = _room(rounds)
        if x[-1] <= 0.0 or not (flat > 0.0).all() or not (room > 0.0).all():
            return float("inf")
        return float(-np.log(x[-1]) - np.log(flat).sum() - np.log(room).sum())

    def slopes(self, x: Array) -> tuple[Array, Array]:
        """Rows B and r with the gradient B' r and the Hessian B' B."""
        flat, rounds = self._of(x)
        of_shift = np.zeros((1, len(x)))
        of_shift[0, -1] = 1.0 / x[-1]
        z, room = rounds.reshape(-1, 3), _room(rounds)
        u = z * np.array((1.0, -1.0, -1.0)) / np.sqrt(room)[:, None]
        W = np.zeros((len(u), 3, 3))
        W[:, 0], W[:, :, 0] = u, u
        W[:, 1:, 1:] = np.eye(2) + u[:, 1:, None] * u[:, None, 1:] / (1.0 + u[:, 0, None, None])
        scaled = np.sqrt(2.0 / room)[:, None, None] * W
        turned = np.matmul(scaled, self._round[0].reshape(-1, 3, len(x)))
        r = np.tile((-(2.0**0.5), 0.0, 0.0), len(u))
        flats = self._flat[0] / flat[:, None]
        B = np.concatenate((of_shift, flats, turned.reshape(-1, len(x))))
        return B, np.concatenate((-np.ones(1 + len(flat)), r))


def _room(rounds: Array) -> Array:
    """z_n^2 - |z_t|^2 without the cancellation of squares, negative outside."""
    normal, one, two = rounds.reshape(-1, 3).T
    across = np.hypot(one, two)
    return (normal - across) * np.where(normal > 0.0, normal + across, 1.0)


def _centred(x: Array, rows: tuple[Array, Array], barrier: _Barrier, weight: float) -> Array:
    """Newton's method for one weight of the barrier."""
    A, c = rows
    wide = np.concatenate((A, np.zeros((len(A), 1))), axis=1)
    price = np.zeros(len(x))
    price[-1] = _PRICE

    def cost(x: Array) -> float:
        r = wide.dot(x) + c
        return float(0.5 * r.dot(r) + _PRICE * x[-1]) + weight * barrier.value(x)

    for _ in range(_NEWTON_STEPS):
        B, r = barrier.slopes(x)
        root = weight**0.5
        stacked = np.concatenate((wide, root * B))
        residual = wide.dot(x) + c
        gradient = wide.T.dot(residual) + weight * B.T.dot(r) + price
        Q: Any = np.linalg.qr(stacked, mode="r")
        step = -np.linalg.solve(Q, np.linalg.solve(Q.T, gradient))
        descent = -float(gradient.dot(step))
        if not descent > _CENTRED * weight:
            break
        now, share = cost(x), 1.0
        for _ in range(_HALVINGS):
            if cost(x + share * step) <= now - _LEAST_DESCENT * share * descent:
                break
            share *= 0.5
        else:
            break
        x = x + share * step
    return x


def least_with_open(y: Array, N: Array, A: Array, c: Array, limits: Limits) -> Array | None:
    """Solve the problem above; arguments as for `least_in_cones`.

    Returns:
        The vector; None where this is not the way to it.
    """
    rows, at = A.dot(N), c - A.dot(y)
    size = float(np.abs(y).max(initial=0.0))
    is_open = np.zeros(len(limits.cones), dtype=np.bool_)
    solution = y
    for _ in range(len(is_open) + 1):
        closed = limits.cones[is_open].ravel()
        w = _least(rows, at, N[closed], -y[closed])
        if w is None:
            return None
        solution = y + N.dot(w)
        excess = limits.excess(solution) > _WITHIN * size
        if not excess.any():
            solution[closed] = 0.0
            return solution if _is_priced(rows, at, w, N[closed], limits.mu[is_open]) else None
        pulls = (solution[limits.cones[:, 0]] < 0.0) & ~is_open
        if not pulls.any():
            return None
        is_open |= pulls
    return None


def _least(rows: Array, at: Array, equalities: Array, values: Array) -> Array | None:
    """The w of least |rows w - at| with held w = values; None where no w has that."""
    if not len(equalities):
        free: Any = np.linalg.lstsq(rows, at, rcond=SINGULAR**2)[0]
        return np.asarray(free)
    U, s, Vt = np.linalg.svd(equalities)
    rank = int(np.count_nonzero(s > SINGULAR))
    w = Vt[:rank].T.dot(U[:, :rank].T.dot(values) / s[:rank])
    largest = float(np.abs(values).max(initial=0.0))
    if np.abs(equalities.dot(w) - values).max(initial=0.0) > _WITHIN * largest:
        return None
    Z = Vt[rank:].T
    if Z.shape[1]:
        more: Any = np.linalg.lstsq(rows.dot(Z), at - rows.dot(w), rcond=SINGULAR**2)[0]
        w = w + Z.dot(more)
    return np.asarray(w)


def _is_priced(rows: Array, at: Array, w: Array, equalities: Array, mu: Array) -> bool:
    """Whether every open contact would move apart."""
    if not len(equalities):
        return True
    gradient = rows.T.dot(rows.dot(w) - at)
    prices: Any = np.linalg.lstsq(equalities.T, gradient, rcond=SINGULAR)[0]
    normal, one, two = prices.reshape(-1, 3).T
    least = -_PRICED * float(np.abs(prices).max())
    return bool((normal - mu * np.hypot(one, two) >= least).all())


class Limits(NamedTuple):
    """The feasible set of a vector: bounds, and cones |y_t| <= mu y_n.

    Attributes:
        lower: Lower ends, shape (n,).
        upper: Upper ends, shape (n,).
        cones: Where a normal and its two tangents stand in y, shape (k, 3).
        mu: Coefficient of friction of each, >= 0, shape (k,).
    """

    lower: Array
    upper: Array
    cones: NDArray[np.intp]
    mu: Array

    def excess(self, y: Array) -> Array:
        """By how much y passes each bound, then each cone, shape (n + k,)."""
        tangents = np.hypot(*y[self.cones[:, 1:]].T)
        beyond = tangents - self.mu * y[self.cones[:, 0]]
        return np.concatenate((np.maximum(self.lower - y, y - self.upper), beyond))

    def passed(self, y: Array, margin: float) -> NDArray[np.bool_]:
        """Which numbers pass their limits by more than a share of the largest, shape (n,)."""
        excess = self.excess(y) > margin * np.abs(y).max(initial=0.0)
        passed: NDArray[np.bool_] = excess[: len(y)]
        passed[self.cones[excess[len(y) :]].ravel()] = True
        return passed


def balanced(A: Array, b: Array, unit: Array) -> tuple[Array, bool]:
    """An x with A x + b = 0 for rows that may depend on one another, and whether there are others.

    A is the mobility of the rows, not symmetric where contacts slip. Source of the pseudo-inverse:
    G. H. Golub, C. F. Van Loan, Matrix Computations, 2013, sec. 5.5.
    It is NaN where A is not finite: of a state that diverges, which its simulation reports.

    Args:
        A: Shape (n, n), n > 0.
        b: Shape (n,).
        unit: Values of x that change the rows about alike, shape (n,).

    Raises:
        SolveError: There is none.
    """
    scaled, right = unit[:, None] * A * unit, unit * b
    if not np.isfinite(scaled).all():
        return np.full(len(b), np.nan), False
    n = len(b)
    factor = eigenpy.CompleteOrthogonalDecomposition(n, n)
    factor.setThreshold(redundant(n))
    factor.compute(scaled)
    found = factor.solve(right).reshape(-1)
    found -= factor.solve(scaled.dot(found) - right).reshape(-1)
    _check(scaled, found, right)
    return -unit * found, factor.rank() < n


def _check(A: Array, x: Array, b: Array) -> None:
    left = np.abs(A.dot(x) - b).max()
    if left > 0.0 and left > CONTRADICTION * (np.abs(A).dot(np.abs(x)) + np.abs(b)).max():
        raise SolveError("rows of a contact and those beside it contradict one another")


def least_balanced(A: Array, b: Array, unit: Array) -> tuple[Array, bool]:
    """The smallest x with A x + b = 0, and whether there are others; as `balanced`."""
    scaled, right = unit[:, None] * A * unit, unit * b
    if not np.isfinite(scaled).all():
        return np.full(len(b), np.nan), False
    U, s, Vt = np.linalg.svd(scaled)
    n = int(np.count_nonzero(s > redundant(len(b)) * s[0]))
    left, ahead, null = U[:, :n].T, Vt[:n].T / s[:n], Vt[n:]
    solution = ahead.dot(left.dot(right))
    solution -= ahead.dot(left.dot(scaled.dot(solution) - right))  # what unequal masses leave
    _check(scaled, solution, right)
    solution *= -unit
    if len(null) == 1:
        along = unit * null[0]
        solution -= along * (along.dot(solution) / along.dot(along))
    elif len(null):
        same = np.linalg.qr((null * unit).T)[0]
        solution -= same.dot(same.T.dot(solution))
    return solution, len(null) > 0
