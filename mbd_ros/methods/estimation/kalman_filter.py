"""Kalman filter and Rauch-Tung-Striebel smoother on the manifold of consistent states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.methods.estimation.kalman_update import Update, compute_update
from mbd_ros.methods.estimation.process import (
    Belief,
    Estimator,
    Measurement,
    Observation,
    Process,
    Transition,
    transport_covariance,
)

_JITTER = 1.0e-14  # relative to the largest variance, where some variances are 0


class KalmanFilter(Estimator):
    """Extended Kalman filter: prediction with P <- F P F' + G Q G', correction by `kalman_update`.

    Corrections are tangent steps, so couplings and loops stay closed, and P is a covariance in the
    tangent. With several iterations the measurement is linearised again about the corrected state,
    which is the Gauss-Newton method for the maximum of the posterior. Source: B. M. Bell,
    F. W. Cathey, IEEE Trans. Autom. Control 38(2) (1993).

    Args:
        iterations: Number of linearisations for each measurement.

    Attributes:
        transition: The newest predicted interval; None before the first one.
        predicted: Belief at its end, before the measurement.
    """

    def __init__(self, process: Process, iterations: int = 1) -> None:
        super().__init__(process)
        self.iterations = iterations
        self._u: Array | None = None
        self.transition: Transition | None = None

    def predict(self, u: Array | None, t: float) -> Belief:
        """Predict state and covariance at a later time, see `Estimator.predict`."""
        transition = self.process.advance(self.belief.x, u, t)
        P = transition.F.dot(self.belief.P).dot(transition.F.T) + transition.noise
        self.transition = transition
        self._u = u
        self.predicted = self.belief._replace(t=t, x=transition.x, P=0.5 * (P + P.T))
        self.belief = self.predicted
        return self.belief

    def correct(self, measurement: Measurement, observation: Observation | None = None) -> Belief:
        """Correct the belief by a measurement, see `Estimator.correct`."""
        process, prior = self.process, self.belief
        x, update, innovation = prior.x, None, None
        for _ in range(self.iterations):
            if observation is None or x is not prior.x:
                expected = process.observe(x, self._u)
            else:
                expected = observation
            update = self._update(x, measurement, expected)
            innovation = update.innovation if innovation is None else innovation
            x = process.plus(prior.x, update.step)
        assert update is not None
        P = transport_covariance(process, update.P, prior.x, x)
        self.belief = prior._replace(x=x, P=P, innovation=innovation)
        return self.belief

    def begin(self, x: Any, P: Array, t: float = 0.0) -> Belief:
        """Begin with a prior, see `Estimator.begin`."""
        self._u = self.transition = None
        self.predicted = super().begin(x, P, t)
        return self.predicted

    @property
    def sample(self) -> FilterSample:
        """The newest sample, as the smoothers take it."""
        F = None if self.transition is None else self.transition.F
        return FilterSample(F, self.predicted, self.belief)

    def checkpoint(self) -> Any:
        """Return the belief and the inputs of the newest sample."""
        return self.belief, self._u

    def restore(self, checkpoint: Any) -> None:
        """Return to the state in which `checkpoint` was taken."""
        self.belief, self._u = checkpoint

    def _update(self, x: Any, measurement: Measurement, expected: Observation) -> Update:
        """Update the prior by a measurement that is linearised at x."""
        prior = self.belief
        error = measurement.values - expected.y
        if x is not prior.x:
            error = error + expected.H.dot(self.process.minus(x, prior.x))
        return compute_update(prior.P, expected.H, expected.R, error, measurement.used)


def smooth(process: Process, samples: Sequence[FilterSample]) -> list[Belief]:
    """Return an estimate for each sample from all measurements (Rauch-Tung-Striebel smoother).

        C = P F' P-^-1,   d_k = C (x_k+1 (-) x-_k+1),   P_k = P + C (P_k+1 - P-) C'

    Source: H. E. Rauch, F. Tung, C. T. Striebel, AIAA Journal 3(8) (1965).

    Args:
        process: Process of the filter.
        samples: Samples of the filter in the order of time. Where F is None the filter restarted,
            so later measurements do not affect earlier estimates.
    """
    if not samples:
        return []
    after = samples[-1].belief
    beliefs = [after]
    for now, following in zip(samples[-2::-1], samples[:0:-1], strict=True):
        if following.F is None:
            after = now.belief
        else:
            after = _smooth_step(process, now.belief, following, after)
        beliefs.append(after)
    return beliefs[::-1]


def _smooth_step(process: Process, now: Belief, following: FilterSample, after: Belief) -> Belief:
    """Return the smoothed belief of a sample from that of the following one."""
    predicted, F = following.predicted, following.F
    assert F is not None
    gain = _solve(predicted.P, F.dot(now.P)).T
    step = gain.dot(process.minus(after.x, predicted.x))
    x = process.plus(now.x, step)
    after_P = transport_covariance(process, after.P, after.x, predicted.x)
    P = now.P + gain.dot(after_P - predicted.P).dot(gain.T)
    return now._replace(x=x, P=transport_covariance(process, 0.5 * (P + P.T), now.x, x))


def _solve(P: Array, right: Array) -> Array:
    """Solve P X = right; variances that are 0 get a small value first."""
    factor = eigenpy.LLT(P)
    if factor.info() != eigenpy.ComputationInfo.Success:
        factor = eigenpy.LLT(P + _JITTER * P.diagonal().max() * np.eye(len(P)))
    solution: Array = factor.solve(right).reshape(right.shape)
    return solution


def smooth_with_lag(process: Process, samples: Sequence[FilterSample], lag: float) -> list[Belief]:
    """Return an estimate for each sample from all measurements until a time after it.

    Args:
        process: Process of the filter.
        samples: Samples of the filter in the order of time, see `smooth`.
        lag: Time after each sample until which measurements count [s].
    """
    beliefs, end = list[Belief](), 0
    for i, sample in enumerate(samples):
        while end < len(samples) and samples[end].belief.t <= sample.belief.t + lag:
            end += 1
        beliefs.append(smooth(process, samples[i : max(end, i + 1)])[0])
    return beliefs


class FilterSample(NamedTuple):
    """One sample of a filter.

    Attributes:
        F: Derivative of `predicted` with respect to the previous estimate; None for the first one.
        predicted: Belief before the measurement.
        belief: Belief after the measurement.
    """

    F: Array | None
    predicted: Belief
    belief: Belief
