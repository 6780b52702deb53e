"""The Kalman filter and smoother on the manifold of consistent states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.methods.estimation.kalman_update import Update, updated
from mbd_ros.methods.estimation.process import (
    Belief,
    Estimator,
    Measurement,
    Observation,
    Process,
    Transition,
    moved,
)

_JITTER = 1.0e-14  # of the largest variance, for covariances of what is known exactly


class KalmanFilter(Estimator):
    """x goes on as the process does; its covariance by F P F' + G Q G', then `kalman_update`.

    Corrections are steps of the tangent, so that couplings and loops stay closed; P lies in it.
    With `iterations` the measurement is linearised again about what it says: Gauss and Newton's
    method for the maximum of the posterior. Source: B. M. Bell, F. W. Cathey, IEEE Trans. Autom.
    Control 38(2) (1993).

    Args:
        iterations: Linearisations a measurement.

    Attributes:
        going: The interval that was predicted last; None before the first one.
        predicted: What was believed at its end, before the measurement.
    """

    def __init__(self, process: Process, iterations: int = 1) -> None:
        super().__init__(process)
        self.iterations = iterations
        self._u: Array | None = None
        self.going: Transition | None = None

    def predict(self, u: Array | None, t: float) -> Belief:
        """As `Estimator.predict`."""
        going = self.process.advance(self.belief.x, u, t)
        P = going.F.dot(self.belief.P).dot(going.F.T) + going.noise
        self.going, self._u = going, u
        self.belief = self.predicted = self.belief._replace(t=t, x=going.x, P=0.5 * (P + P.T))
        return self.belief

    def correct(self, measurement: Measurement, seen: Observation | None = None) -> Belief:
        """As `Estimator.correct`."""
        process, prior = self.process, self.belief
        x, found, first = prior.x, None, None
        for _ in range(self.iterations):
            here = seen if seen is not None and x is prior.x else process.observe(x, self._u)
            found = self._update(x, measurement, here)
            first = found.innovation if first is None else first
            x = process.plus(prior.x, found.step)
        assert found is not None
        P = moved(process, found.P, prior.x, x)
        self.belief = prior._replace(x=x, P=P, innovation=first)
        return self.belief

    def begin(self, x: Any, P: Array, t: float = 0.0) -> Belief:
        """As `Estimator.begin`."""
        self._u = self.going = None
        self.predicted = super().begin(x, P, t)
        return self.predicted

    @property
    def sample(self) -> Filtered:
        """The newest sample, for smoothers."""
        F = None if self.going is None else self.going.F
        return Filtered(F, self.predicted, self.belief)

    def checkpoint(self) -> Any:
        """As `Estimator.checkpoint`."""
        return self.belief, self._u

    def restore(self, checkpoint: Any) -> None:
        """As `Estimator.restore`."""
        self.belief, self._u = checkpoint

    def _update(self, x: Any, measurement: Measurement, seen: Observation) -> Update:
        """The update of the prior by a measurement that is linearised at x."""
        prior = self.belief
        error = measurement.values - seen.y
        if x is not prior.x:
            error = error + seen.H.dot(self.process.minus(x, prior.x))
        return updated(prior.P, seen.H, seen.R, error, measurement.used)


def smoothed(process: Process, samples: Sequence[Filtered]) -> list[Belief]:
    """Estimates by all measurements, one a sample: the Rauch-Tung-Striebel smoother.

        C = P F' P-^-1,   d_k = C (x_k+1 (-) x-_k+1),   P_k = P + C (P_k+1 - P-) C'

    Source: H. E. Rauch, F. Tung, C. T. Striebel, AIAA Journal 3(8) (1965).

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


class Filtered(NamedTuple):
    """One sample of a filter.

    Attributes:
        F: Derivative of `predicted` by the estimate of the sample before; None for the first one.
        predicted: Before the measurement.
    """

    F: Array | None
    predicted: Belief
    belief: Belief
