"""A guess whose loops are closed: coordinates that it does not move follow those that it does."""

from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.unknowns import PhaseMotion

_MOST = 30  # Newton steps
_CLOSED = 1.0e-9  # rad or m
_LONGEST = 0.5  # rad or m of a step: the guess stays on the branch that it is on
_STRIDE = 0.02  # of the duration: from one closed configuration to the next


def close(equations: Any, motion: PhaseMotion, p: Array) -> None:
    """Close the loops of a guess, configurations and velocities, where that is possible.

    Args:
        equations: Of the phase, `PhaseEquations`.
        motion: The guess, which is changed.
        p: Parameters.
    """
    q, shares = motion.nodes["q"], np.concatenate((motion.mesh.knots, motion.mesh.shares))
    moved = np.abs(q - q[0]).max(axis=0) > 0.0
    flat = equations.flat
    free = np.array([j for i, j in flat if not moved[i]], dtype=np.intp)
    of_q = {int(j): int(i) for i, j in flat}
    if not equations.sizes.mg or not len(free):
        return
    places = [of_q[int(j)] for j in free]
    fine = np.unique(np.concatenate((shares, np.arange(0.0, 1.0, _STRIDE))))
    whole = np.empty((len(fine), q.shape[1]))
    for i in range(q.shape[1]):
        whole[:, i] = np.interp(fine, motion.mesh.knots, q[:, i])
    follower = whole[0, places].copy()
    speeds = np.empty((len(fine), motion.nodes["v"].shape[1]))
    for i, row in enumerate(whole):
        row[places] = follower
        t = motion.begin + motion.duration * fine[i]
        _closed(equations, t, row, free, places, p)
        follower = row[places].copy()
        v = np.array([np.interp(fine[i], motion.mesh.knots, one) for one in motion.nodes["v"].T])
        v[free] = 0.0
        _, _, rate, J = equations.rows_at(t, row, v, p)
        v[free] -= np.linalg.lstsq(J[:, free], rate, rcond=None)[0]
        speeds[i] = v
    for at, found in ((motion.mesh.knots, motion.nodes), (motion.mesh.shares, motion.points)):
        rows = np.searchsorted(fine, at)
        found["q"][:, places], found["v"][:, free] = whole[rows][:, places], speeds[rows][:, free]


def _closed(equations: Any, t: float, q: Array, free: Array, places: list[int], p: Array) -> None:
    """Newton's method on some coordinates; the nearest ones where rows do not determine them."""
    still = np.zeros(equations.sizes.nv)
    for _ in range(_MOST):
        g, J, _, _ = equations.rows_at(t, q, still, p)
        if np.abs(g).max(initial=0.0) < _CLOSED:
            return
        step = np.linalg.lstsq(J[:, free], -g, rcond=None)[0]
        size = float(np.abs(step).max(initial=0.0))
        q[places] += step * min(1.0, _LONGEST / max(size, _LONGEST))
