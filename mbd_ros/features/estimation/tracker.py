"""Tracking: an estimator whose samples are late, out of order, missing or wrong."""

from bisect import bisect_right
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.estimation.faults import InnovationWatch, SensorFaults
from mbd_ros.methods.estimation.kalman_filter import FilterSample, KalmanFilter, smooth
from mbd_ros.methods.estimation.process import Belief, Estimator, Measurement, Process, SensorSet

_COINCIDENT = 1.0e-9  # [s] within which two samples are one
_GAP = 5.0  # mean intervals: a longer interval between samples is a gap
_FORGETTING = 0.1  # weight of the newest interval in the mean one
MOST_SAMPLES = 1000  # that are stored, so that late ones can be inserted
_DETERMINED = 4.0  # ratio of predicted variance to noise above which other sensors say little


class SampleOutcome(Enum):
    """Use of a sample."""

    USED = "used"
    PLACED = "late: inserted at its time"
    OLD = "older than all stored samples"


class Tracker:
    """Feeds an estimator with samples as they arrive.

    A late sample is inserted at its time, unless it is older than `memory` or than the last
    `MOST_SAMPLES` samples: the estimator goes back to this time and repeats all later samples.

    Inputs in a gap between samples are unknown. After a gap longer than `patience`, the mechanism
    is assumed at rest where it is measured, with the uncertainty that `agility` allows.

    Args:
        estimator: Estimator that has begun.
        sensors: Sensors of the numbers of a measurement.
        memory: Largest delay of a sample [s].
        patience: Time after which unused numbers are a fault [s].
        max_age: Time after which a missing number is a fault [s].
        gate: Change of an innovation that noise may cause, in deviations; beyond it a sensor has
            jumped.
        agility: Accelerations that inputs do not explain [rad/s^2 or m/s^2].
        longest: Longest interval between samples that is predicted; a longer one is a gap [s].

    Attributes:
        is_hurried: Whether the estimator is too slow, so that late samples count as too old,
            intervals longer than `patience` are gaps, and after a gap the mechanism is where it
            was.
        faults: Faults of sensors.
        watch: Statistics of the newest innovations.
        restarts: Number of restarts of the estimator, because nothing fitted.
        window: Samples whose estimates wait for later ones, for a Kalman filter; None without.
    """

    def __init__(
        self,
        estimator: Estimator,
        sensors: SensorSet,
        *,
        memory: float = 0.2,
        patience: float = 0.1,
        max_age: float = 0.5,
        gate: float = 6.0,
        agility: float = 50.0,
        longest: float = np.inf,
    ) -> None:
        self.estimator = estimator
        self._sensors = sensors
        self._memory = memory
        self.faults = SensorFaults(sensors, gate, agility, patience, max_age)
        self.watch = InnovationWatch()
        self.restarts = 0
        self._patience = patience
        self._max_age = max_age
        self._agility = agility
        self._longest = longest
        self.is_hurried = False
        self._mean_interval = np.inf  # s, between samples
        self._prior: Array = estimator.belief.P
        self._steps = list[_Step]()
        self.window: LagWindow | None = None
        self.faults.reset(estimator.belief.t)

    @property
    def belief(self) -> Belief:
        """Newest belief of the estimator."""
        return self.estimator.belief

    def add_sample(self, t: float, values: Array, u: Array | None) -> SampleOutcome:
        """Add a sample.

        Args:
            t: Time of the measurement [s].
            values: Measured values, NaN where there are none, shape (m,).
            u: Inputs that were held until then.

        Raises:
            SolveError: Equations are inconsistent.
            DivergedError: The prediction is not finite.
        """
        if t >= self.belief.t - _COINCIDENT:
            self._step(t, values, u)
            return SampleOutcome.USED
        if self.is_hurried or not self._steps or t < self._steps[0].since:
            return SampleOutcome.OLD
        index = bisect_right([step.t for step in self._steps], t)
        later_steps = self._steps[index:]
        del self._steps[index:]
        if later_steps:
            self._go_back(later_steps[0].before)
        self._step(t, values, u)
        for step in later_steps:
            self._step(step.t, step.values, step.u)
        return SampleOutcome.PLACED

    def _go_back(self, before: Any) -> None:
        estimator, faults, self._mean_interval = before
        self.estimator.restore(estimator)
        self.faults.restore(faults)
        if self.window is not None:
            self.window.drop_after(self.belief.t)

    def _step(self, t: float, values: Array, u: Array | None) -> None:
        estimator = self.estimator
        before = estimator.checkpoint(), self.faults.checkpoint(), self._mean_interval
        self._steps.append(_Step(t, self.belief.t, values, u, before))
        while self._steps[0].t < t - self._memory or len(self._steps) > MOST_SAMPLES:
            del self._steps[0]
        dt = max(t - self.belief.t, 0.0)
        if dt > _COINCIDENT:
            self._predict(t, values, u, dt)
        observation = estimator.process.observe(self.belief.x, u)
        values = self._sensors.near(values, observation.y)
        H = observation.H
        predicted_variance = np.einsum("ij,ij->i", H.dot(self.belief.P), H)
        noise = observation.R.diagonal()
        is_usable = self.faults.usable(
            values, observation.y, np.sqrt(predicted_variance + noise), dt
        )
        belief = estimator.correct(Measurement(t, values, is_usable), observation)
        assert belief.innovation is not None
        self.faults.note(t, values, belief.innovation)
        self.watch.add(belief.innovation)
        if (self.faults.refused() & (predicted_variance > _DETERMINED * noise)).any():
            self._widen(t, values)
        if self.window is not None and isinstance(estimator, KalmanFilter):
            self.window.add(estimator.sample, u)

    def _predict(self, t: float, values: Array, u: Array | None, dt: float) -> None:
        """Predict to the time of the next sample, or restart at rest after a gap."""
        estimator, process = self.estimator, self.estimator.process
        longest = self._patience if self.is_hurried else self._longest
        if dt > min(longest, max(self._patience, _GAP * self._mean_interval)):
            variance = process.unmodelled_variance(self._agility, min(dt, self._max_age))
            P = self.belief.P + np.diag(variance)
            x = process.at_rest(self.belief.x, t)
            if not self.is_hurried:
                x = process.fit_state(x, values, P)
            estimator.begin(x, P, t)
            return
        mean = dt if self._mean_interval == np.inf else self._mean_interval
        self._mean_interval = mean + _FORGETTING * (dt - mean)
        estimator.predict(u, t)

    def _widen(self, t: float, values: Array) -> None:
        """Restart from the initial covariance, because a sensor has not fitted for long.

        No other sensor contradicts it, so the estimate is lost.
        """
        self.restarts += 1
        estimator = self.estimator
        x = estimator.process.fit_state(self.belief.x, values, self._prior)
        estimator.begin(x, self._prior, t)
        belief = estimator.correct(Measurement(t, values))
        self._steps.clear()
        self.faults.reset(t)
        self.watch.reset()
        assert belief.innovation is not None
        self.faults.note(t, values, belief.innovation)


class _Step(NamedTuple):
    """A sample, and the state of the estimator before it."""

    t: float
    since: float
    values: Array
    u: Array | None
    before: Any


class Delayed(NamedTuple):
    """The estimate of a sample from all measurements until its lag was over.

    Attributes:
        belief: The estimate; its innovation is that of the filter.
        u: Inputs until then; None without inputs.
    """

    belief: Belief
    u: Array | None


class LagWindow:
    """The newest samples, whose estimates wait for later measurements.

    At most `MOST_SAMPLES` wait; the oldest ones are then due before their lag is over.

    Args:
        process: The process that is filtered.
        lag: Time after a sample during which measurements improve its estimate [s].
    """

    def __init__(self, process: Process, lag: float) -> None:
        self._process = process
        self._lag = lag
        self._reported_until = -np.inf
        self._samples = list[FilterSample]()
        self._inputs = list[Array | None]()

    def add(self, sample: FilterSample, u: Array | None) -> None:
        """Add the newest sample; one at the time of the last sample replaces its belief."""
        if self._samples and sample.belief.t <= self._samples[-1].belief.t + _COINCIDENT:
            self._samples[-1] = self._samples[-1]._replace(belief=sample.belief)
            self._inputs[-1] = u
        elif sample.belief.t > self._reported_until + _COINCIDENT:
            self._samples.append(sample)
            self._inputs.append(u)

    def drop_after(self, t: float) -> None:
        """Drop the samples after a time [s], because they will be added again."""
        while self._samples and self._samples[-1].belief.t > t + _COINCIDENT:
            del self._samples[-1], self._inputs[-1]

    def due(self) -> list[Delayed]:
        """Return the estimates of the samples whose lag is over, by time, each once."""
        if not self._samples:
            return []
        end = self._samples[-1].belief.t - self._lag + _COINCIDENT
        count = sum(sample.belief.t <= end for sample in self._samples)
        count = max(count, len(self._samples) - MOST_SAMPLES)
        if not count:
            return []
        self._reported_until = self._samples[count - 1].belief.t
        pairs = zip(smooth(self._process, self._samples), self._inputs, strict=True)
        estimates = [Delayed(belief, u) for belief, u in pairs][:count]
        del self._samples[:count], self._inputs[:count]
        return estimates
