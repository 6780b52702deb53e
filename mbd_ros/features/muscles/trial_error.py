"""How far activations of a trial are off between the points where it is looked at."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.muscles.array_numbers import ArrayNumbers
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import Array
from mbd_ros.features.muscles.muscle_trial import Excited
from mbd_ros.features.muscles.trial_points import Points


def between(muscles: Sequence[Muscle], points: Points, found: Excited) -> Array:
    """Largest error of the activations over each interval, by their defect between the points.

    Args:
        muscles: The muscles.
        points: Where they are looked at.
        found: What they do there.
    """
    ends = np.concatenate(([0.0], points.scheme.c))
    inner, h = 0.5 * (ends[1:] + ends[:-1]), np.diff(points.knots)[:, None]
    t, short = (points.knots[:-1, None] + h * inner).ravel(), 1.0e-4 * h.min()
    before, after = (points.states(found.activation, t + way * short) for way in (-1.0, 1.0))
    a, e = 0.5 * (before + after), points.inputs(found.excitation, t)
    rates = [m.dynamics.rate(ArrayNumbers, e[:, i], a[:, i]) for i, m in enumerate(muscles)]
    defect = np.abs((after - before) / (2.0 * short) - np.stack(rates, axis=1)).max(axis=1)
    widest = h[:, 0] * np.diff(ends).max()
    found_: Array = defect.reshape(len(h), -1).max(axis=1) * widest
    return found_
