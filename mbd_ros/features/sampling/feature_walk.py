"""Walks along rows towards the features of another configuration."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.ensemble import Ensemble
from mbd_ros.features.sampling.observables import Observable
from mbd_ros.features.sampling.space import Marks

_STEPS = 200
_LONGEST = 0.02  # of the scale: change of a coordinate in a step
_STRAIGHT = 0.2  # of a step: how far the rows may bend it; more is a jump to another branch
_WEAK = 1.0e-6  # singular values beside the largest that count as none
_ARRIVED = 0.03  # of the spread of features


def arrives(
    ensemble: Ensemble,
    start: Array,
    end: Array,
    features: Sequence[Observable],
    spread: Array,
) -> Marks:
    """Which walks come to the features of their ends, shape (walks,).

    Steps are short, end on the rows and never cross a wall, so that one that arrives is a motion.

    Args:
        ensemble: Whose rows and walls count.
        start: Configurations, shape (size, walks).
        end: Configurations with the features that are looked for.
        features: Quantities.
        spread: Their usual size, > 0.
    """
    wanted = np.array([one.value(end) for one in features]) / spread[:, None]
    q, longest = start, _LONGEST * ensemble.space.scale
    there, walks = np.zeros(start.shape[1], dtype=np.bool_), np.arange(start.shape[1])
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            left = wanted - np.array([one.value(q) for one in features]) / spread[:, None]
            is_there = np.abs(left).max(axis=0) < _ARRIVED
            there[walks[is_there]] = True
            goes = ~is_there
            q, wanted, left, walks = q[:, goes], wanted[:, goes], left[:, goes], walks[goes]
            if not len(walks):
                break
            q, found = _stepped(ensemble, q, left, features, spread, longest)
            q, wanted, walks = q[:, found], wanted[:, found], walks[found]
    return there


def _stepped(
    ensemble: Ensemble,
    q: Array,
    left: Array,
    features: Sequence[Observable],
    spread: Array,
    longest: float,
) -> tuple[Array, Marks]:
    """A step of Gauss and Newton along the rows, and where there is one."""
    manifold = ensemble.manifold
    places = manifold.at(q)
    slopes = np.array([manifold.project(places, one.gradient(q)) for one in features])
    slopes /= spread[:, None, None]
    inverse = np.linalg.pinv(np.nan_to_num(slopes).transpose(2, 0, 1), rcond=_WEAK)
    step = manifold.project(places, np.einsum("bik,kb->ib", inverse, left))
    size = np.abs(step).max(axis=0)
    step *= np.minimum(1.0, longest / np.maximum(size, 1.0e-300))
    there, found = manifold.close(places, q + step)
    bent = np.abs(there - q - step).max(axis=0)
    found &= bent <= _STRAIGHT * np.minimum(size, longest)
    return there, found & np.isfinite(ensemble.space.potential(there))
