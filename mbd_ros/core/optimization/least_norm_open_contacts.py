"""The least forces of contacts where the contacts that do not press exert nothing at all.

    min |A y - c|^2,   y = y0 + N w,   y_i = 0 for contacts i that are open

Contacts that would pull are opened one after the other. The answer is that of all cones where
none is left beyond its own, and every open one would move apart: its price z, with the gradient
N' A' (A y - c) = sum of N_i' z_i, is in the dual cone mu |z_t| <= z_n. Source: S. Boyd, L.
Vandenberghe, Convex Optimization, 2004, sec. 5.5.3 and 5.9.
"""

from typing import Any

import numpy as np

from mbd_ros.core.optimization.cone_limits import Limits
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import SINGULAR

_KEPT = 1.0e-10  # of the largest number: what rounding leaves of a limit that is kept
_PRICED = 1.0e-9  # of the largest price: one that is not negative


def least_with_open(y: Array, N: Array, A: Array, c: Array, limits: Limits) -> Array | None:
    """Solve the problem above; arguments as for `least_in_cones`.

    Returns:
        The vector; None where this is not the way to it.
    """
    rows, at = A.dot(N), c - A.dot(y)
    size = float(np.abs(y).max(initial=0.0))
    is_open = np.zeros(len(limits.cones), dtype=np.bool_)
    found = y
    for _ in range(len(is_open) + 1):
        closed = limits.cones[is_open].ravel()
        w = _least(rows, at, N[closed], -y[closed])
        if w is None:
            return None
        found = y + N.dot(w)
        excess = limits.excess(found) > _KEPT * size
        if not excess.any():
            found[closed] = 0.0
            return found if _is_priced(rows, at, w, N[closed], limits.mu[is_open]) else None
        pulls = (found[limits.cones[:, 0]] < 0.0) & ~is_open
        if not pulls.any():
            return None
        is_open |= pulls
    return None


def _least(rows: Array, at: Array, held: Array, values: Array) -> Array | None:
    """The w of least |rows w - at| with held w = values; None where no w has that."""
    if not len(held):
        free: Any = np.linalg.lstsq(rows, at, rcond=SINGULAR**2)[0]
        return np.asarray(free)
    U, s, Vt = np.linalg.svd(held)
    rank = int(np.count_nonzero(s > SINGULAR))
    w = Vt[:rank].T.dot(U[:, :rank].T.dot(values) / s[:rank])
    largest = float(np.abs(values).max(initial=0.0))
    if np.abs(held.dot(w) - values).max(initial=0.0) > _KEPT * largest:
        return None
    Z = Vt[rank:].T
    if Z.shape[1]:
        more: Any = np.linalg.lstsq(rows.dot(Z), at - rows.dot(w), rcond=SINGULAR**2)[0]
        w = w + Z.dot(more)
    return np.asarray(w)


def _is_priced(rows: Array, at: Array, w: Array, held: Array, mu: Array) -> bool:
    """Whether every open contact would move apart."""
    if not len(held):
        return True
    gradient = rows.T.dot(rows.dot(w) - at)
    prices: Any = np.linalg.lstsq(held.T, gradient, rcond=SINGULAR)[0]
    normal, one, two = prices.reshape(-1, 3).T
    least = -_PRICED * float(np.abs(prices).max())
    return bool((normal - mu * np.hypot(one, two) >= least).all())
