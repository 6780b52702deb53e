"""How far a motion between its points is from what its inputs make."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.unknowns import PhaseMotion

# shares (m,), then q, v, z, u of each -> accelerations (m, nv), rates of internal states (m, nz)
Rates = Callable[[Array, dict[str, Array]], tuple[Array, Array]]

_LOOKS = 24  # at an interval


class Errors(NamedTuple):
    """Errors of a motion between its nodes.

    Attributes:
        relative: Of each interval: of positions, velocities and internal states, relative to 1 +
            the largest value of each, the largest, shape (n,).
    """

    relative: Array

    @property
    def worst(self) -> float:
        """The largest."""
        return float(self.relative.max(initial=0.0))


def errors_of(motion: PhaseMotion, rates: Rates) -> Errors:
    """The motion held against an integral of its own rates at more points than it has.

    Source: M. A. Patterson, W. W. Hager, A. V. Rao, A ph mesh refinement method for optimal
    control, Optimal Control Applications and Methods 36, 2015, sec. 3.
    """
    mesh, found = motion.mesh, np.zeros(motion.mesh.intervals)
    knots, sizes = mesh.knots, _sizes(motion)
    for degree in np.unique(mesh.degrees).tolist():
        chosen = np.flatnonzero(mesh.degrees == degree)
        finer = mesh.scheme_of(degree).finer
        places = np.append(finer.c, 1.0)
        shares = knots[chosen][:, None] + mesh.widths[chosen][:, None] * places
        shares = np.minimum(shares, np.nextafter(knots[chosen + 1][:, None], 0.0))
        values = motion.at(shares.ravel())
        a, w = rates(shares.ravel(), values)
        h = motion.duration * mesh.widths[chosen]
        for state, rate in (("v", a), ("z", w)):
            if not values[state].shape[1]:
                continue
            some = values[state].reshape(len(chosen), len(places), -1)
            slope = rate.reshape(len(chosen), len(places), -1)[:, :-1]
            weights = np.vstack((finer.A, finer.b))
            integral = h[:, None, None] * np.einsum("jk,ikn->ijn", weights, slope)
            off = np.abs(motion.nodes[state][chosen][:, None] + integral - some) / sizes[state]
            found[chosen] = np.maximum(found[chosen], off.max(axis=(1, 2)))
    return Errors(found)


def looked_at(motion: PhaseMotion) -> tuple[Array, dict[str, Array]]:
    """Places between the points, as shares of the duration, and the motion there.

    Returns:
        Shape (n looks,), intervals one after the other, and letter -> values.
    """
    mesh, places = motion.mesh, (np.arange(_LOOKS) + 0.5) / _LOOKS
    shares = (mesh.knots[:-1, None] + mesh.widths[:, None] * places).ravel()
    return shares, motion.at(shares)


def beyond_bounds(values: Array, lower: Array, upper: Array) -> Array:
    """How far numbers pass their bounds at most in each interval, shape (n, k).

    Args:
        values: At the places of `looked_at`, shape (n looks, k).
        lower: Shape (k,).
        upper: Shape (k,).
    """
    off = np.maximum(np.maximum(lower - values, values - upper), 0.0)
    return off.reshape(-1, _LOOKS, values.shape[1]).max(axis=1)


def _sizes(motion: PhaseMotion) -> dict[str, Array]:
    return {key: 1.0 + np.abs(motion.nodes[key]).max(axis=0, initial=0.0) for key in ("v", "z")}
