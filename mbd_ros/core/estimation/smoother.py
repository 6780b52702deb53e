"""From estimates by what was measured until then to estimates by all that was measured.

    C = P F' P-^-1,   d_k = C (x_k+1 (-) x-_k+1),   P_k = P + C (P_k+1 - P-) C'

Source: H. E. Rauch, F. Tung, C. T. Striebel, AIAA Journal 3(8) (1965).
"""

from collections.abc import Sequence
from typing import NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.estimation.estimator import Belief
from mbd_ros.core.estimation.process import Process, moved
from mbd_ros.core.state import Array

_JITTER = 1.0e-14  # of the largest variance, for covariances of what is known exactly


class Filtered(NamedTuple):
    """One sample of a filter.

    Attributes:
        F: Derivative of `predicted` by the estimate of the sample before; None for the first one.
        predicted: Before the measurement.
        belief: After it.
    """

    F: Array | None
    predicted: Belief
    belief: Belief


def smoothed(process: Process, samples: Sequence[Filtered]) -> list[Belief]:
    """Estimates by all measurements, one a sample.

    Args:
        process: What was filtered.
        samples: In the order of time. Where F is None the filter began anew: nothing that comes
            later says anything on what was before.
    """
    if not samples:
        return []
    after = samples[-1].belief
    found = [after]
    for now, following in zip(samples[-2::-1], samples[:0:-1], strict=True):
        if following.F is None:
            after = now.belief
        else:
            after = _one_back(process, now.belief, following, after)
        found.append(after)
    return found[::-1]


def lagged(process: Process, samples: Sequence[Filtered], lag: float) -> list[Belief]:
    """Estimates by the measurements until a time after each of them, one a sample.

    Args:
        process: What was filtered.
        samples: As for `smoothed`.
        lag: The time [s].
    """
    found, end = list[Belief](), 0
    for i, sample in enumerate(samples):
        while end < len(samples) and samples[end].belief.t <= sample.belief.t + lag:
            end += 1
        found.append(smoothed(process, samples[i : max(end, i + 1)])[0])
    return found


def _one_back(process: Process, now: Belief, following: Filtered, after: Belief) -> Belief:
    predicted, F = following.predicted, following.F
    assert F is not None
    gain = _solved(predicted.P, F.dot(now.P)).T
    step = gain.dot(process.minus(after.x, predicted.x))
    x = process.plus(now.x, step)
    there = moved(process, after.P, after.x, predicted.x)
    P = now.P + gain.dot(there - predicted.P).dot(gain.T)
    return now._replace(x=x, P=moved(process, 0.5 * (P + P.T), now.x, x))


def _solved(P: Array, right: Array) -> Array:
    factor = eigenpy.LLT(P)
    if factor.info() != eigenpy.ComputationInfo.Success:
        factor = eigenpy.LLT(P + _JITTER * P.diagonal().max() * np.eye(len(P)))
    solved: Array = factor.solve(right).reshape(right.shape)
    return solved
