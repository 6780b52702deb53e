"""The smallest of the vectors of an affine set that keep bounds, one group of entries first.

    z = z0 + N y,   lower <= z <= upper

Among these the entries of the first group have the smallest norm. Among those that attain it the
second group has the smallest, and so on. `core/inverse` asks it of efforts and multipliers.
Source: A. Escande, N. Mansard, P. Wieber, Int. J. Robotics Research 33(7) (2014), on the order;
R. T. Rockafellar, SIAM J. Control Optim. 14 (1976), on the steps that leave later groups free.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.optimization.hard_soft_qp import HardSoftQp
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import SINGULAR

_LATER = 1.0e-3  # price of a move of later groups, which is paid for the last step alone
_STEPS = 20
_ARRIVED = 1.0e-12  # of the size of z
_KEPT = 1.0e-9  # the same, by which a bound may be passed


class Least(NamedTuple):
    """The answer.

    Attributes:
        z: The vector, shape (n,); where the bounds cannot be kept the one with the least excess.
        is_within: Whether it keeps them.
    """

    z: Array
    is_within: bool


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


def _refined(z: Array, N: Array, lower: Array, upper: Array, slack: float) -> Array:
    """The same without the last digits by which bounds are passed or missed."""
    low, high = z <= lower + slack, z >= upper - slack
    bound, at_bound = np.where(low, lower, np.where(high, upper, z)), low | high
    onto: Any = np.linalg.lstsq(N[at_bound], (bound - z)[at_bound], rcond=SINGULAR)[0]
    return np.clip(z + N.dot(onto), lower, upper)


def _nearest(z: Array, own: Array, later: Array, lower: Array, upper: Array) -> Least:
    """The z + own w + later y within the bounds whose |w| is the least."""
    n = own.shape[1]
    limited = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if not len(limited):
        return Least(z, True)
    moves = np.concatenate((own, later / _LATER), axis=1)
    free = np.full(moves.shape[1], np.inf)
    G = np.concatenate((np.eye(len(free)), moves[limited]))
    w, tolerance = np.zeros(n), _ARRIVED * (1.0 + float(np.abs(z).max()))
    for _ in range(_STEPS):
        low = np.concatenate((-free, (lower - z)[limited]))
        high = np.concatenate((free, (upper - z)[limited]))
        found = HardSoftQp(len(free), len(limited)).solve(G, low, high)
        if found.is_softened:
            return Least(z + moves.dot(found.y), False)
        before, w = w, found.y[:n]
        z_now = z + moves.dot(found.y)
        if not later.shape[1] or np.abs(w - before).max() <= tolerance:
            break
        z = z + moves[:, n:].dot(found.y[n:])
    return Least(z_now, True)
