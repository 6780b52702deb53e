"""An estimator at work: samples that come late, in disorder, not at all, or wrong."""

from bisect import bisect_right
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.estimation.faults import InnovationWatch, SensorFaults
from mbd_ros.methods.estimation.kalman_filter import Filtered, KalmanFilter, smoothed
from mbd_ros.methods.estimation.process import Belief, Estimator, Measurement, Process, SensorSet

_COINCIDENT = 1.0e-9  # [s] within which two samples are one
_GAP = 5.0  # times the usual interval: more than that between samples is a gap
_FORGETTING = 0.1  # share that the newest interval has in the usual one
MOST_SAMPLES = 1000  # that are remembered, so that late ones can go before them
_DETERMINED = 4.0  # times its noise: what the others say of a number is less certain than that


class Taken(Enum):
    """What became of a sample."""

    USED = "used"
    PLACED = "late: put where it belongs"
    OLD = "older than all that is remembered"


class Tracker:
    """Feeds an estimator with samples as they come.

    A sample that is late goes where it belongs, if that is not longer ago than `memory` nor before
    the last `MOST_SAMPLES` samples: the estimator goes back there and takes all that came since
    again.

    What drove the mechanism in a gap between samples is not known. After one that is longer than
    `patience` it is found where it is, at rest but for what `agility` may have done.

    Args:
        estimator: The estimator; has begun.
        sensors: What the numbers of a measurement are.
        memory: How late a sample may be [s].
        patience: Time after which numbers that do not count are a fault [s].
        max_age: Time after which a number that does not come is a fault [s].
        gate: Deviations by which noise may change an innovation; beyond it a sensor has jumped.
        agility: Accelerations that nobody foresees and that happen all the same
            [rad/s^2 or m/s^2].
        longest: Interval between samples that is predicted at most; a longer one is a gap [s].

    Attributes:
        is_hurried: Whether answers lag behind too far for what takes long: late samples then
            count as too old, what is longer than `patience` is a gap, and after a gap the
            mechanism is where it was.
        faults: What is wrong with sensors.
        watch: The newest innovations.
        restarts: How often the estimator began anew, since nothing fitted.
        window: Of samples whose estimates wait, for a Kalman filter; None without.
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
        self.estimator, self._sensors, self._memory = estimator, sensors, memory
        self.faults = SensorFaults(sensors, gate, agility, patience, max_age)
        self.watch, self.restarts = InnovationWatch(), 0
        self._patience, self._max_age, self._agility = patience, max_age, agility
        self._longest = longest
        self.is_hurried = False
        self._usual = np.inf  # s, between samples
        self._prior: Array = estimator.belief.P
        self._steps = list[_Step]()
        self.window: LagWindow | None = None
        self.faults.forget(estimator.belief.t)

    @property
    def belief(self) -> Belief:
        """The newest one."""
        return self.estimator.belief

    def take(self, t: float, values: Array, u: Array | None) -> Taken:
        """Take a sample.

        Args:
            t: Time of the measurement [s].
            values: NaN where nothing was measured, shape (m,).
            u: Inputs that were held until then.

        Raises:
            SolveError: Equations contradict one another.
            DivergedError: The prediction is no longer finite.
        """
        if t >= self.belief.t - _COINCIDENT:
            self._step(t, values, u)
            return Taken.USED
        if self.is_hurried or not self._steps or t < self._steps[0].since:
            return Taken.OLD
        at = bisect_right([step.t for step in self._steps], t)
        again = self._steps[at:]
        del self._steps[at:]
        if again:
            self._go_back(again[0].before)
        self._step(t, values, u)
        for step in again:
            self._step(step.t, step.values, step.u)
        return Taken.PLACED

    def _go_back(self, before: Any) -> None:
        checkpoint, faults, self._usual = before
        self.estimator.restore(checkpoint)
        self.faults.restore(faults)
        if self.window is not None:
            self.window.back_to(self.belief.t)

    def _step(self, t: float, values: Array, u: Array | None) -> None:
        estimator = self.estimator
        before = estimator.checkpoint(), self.faults.checkpoint(), self._usual
        self._steps.append(_Step(t, self.belief.t, values, u, before))
        while self._steps[0].t < t - self._memory or len(self._steps) > MOST_SAMPLES:
            del self._steps[0]
        dt = max(t - self.belief.t, 0.0)
        if dt > _COINCIDENT:
            self._go_on(t, values, u, dt)
        seen = estimator.process.observe(self.belief.x, u)
        values = self._sensors.near(values, seen.y)
        known = np.einsum("ij,ij->i", seen.H.dot(self.belief.P), seen.H)
        noise = seen.R.diagonal()
        used = self.faults.usable(values, seen.y, np.sqrt(known + noise), dt)
        belief = estimator.correct(Measurement(t, values, used), seen)
        assert belief.innovation is not None
        self.faults.note(t, values, belief.innovation)
        self.watch.add(belief.innovation)
        if (self.faults.refused() & (known > _DETERMINED * noise)).any():
            self._widen(t, values)
        if self.window is not None and isinstance(estimator, KalmanFilter):
            self.window.add(estimator.sample, u)

    def _go_on(self, t: float, values: Array, u: Array | None, dt: float) -> None:
        """To the time of the next sample, by what is known of the time until then."""
        estimator, process = self.estimator, self.estimator.process
        longest = self._patience if self.is_hurried else self._longest
        if dt > min(longest, max(self._patience, _GAP * self._usual)):
            doubt = process.unforeseen(self._agility, min(dt, self._max_age))
            P = self.belief.P + np.diag(doubt)
            x = process.at_rest(self.belief.x, t)
            if not self.is_hurried:
                x = process.near(x, values, P)
            estimator.begin(x, P, t)
            return
        usual = dt if self._usual == np.inf else self._usual
        self._usual = usual + _FORGETTING * (dt - usual)
        estimator.predict(u, t)

    def _widen(self, t: float, values: Array) -> None:
        """A sensor does not fit for long, and no other one says that it is wrong.

        So the estimate is lost, and begins anew where it is, with the doubt of the beginning.
        """
        self.restarts += 1
        estimator = self.estimator
        x = estimator.process.near(self.belief.x, values, self._prior)
        estimator.begin(x, self._prior, t)
        belief = estimator.correct(Measurement(t, values))
        self._steps.clear()
        self.faults.forget(t)
        self.watch.forget()
        assert belief.innovation is not None
        self.faults.note(t, values, belief.innovation)


class _Step(NamedTuple):
    """A sample that was taken, and what was believed before it."""

    t: float
    since: float
    values: Array
    u: Array | None
    before: Any


class Delayed(NamedTuple):
    """The estimate of a sample by all that was measured until its lag was over.

    Attributes:
        belief: The estimate; its innovation is that of the filter.
        u: Inputs until then, None without.
    """

    belief: Belief
    u: Array | None


class LagWindow:
    """The newest samples, whose estimates wait for what is measured a while later.

    More than `MOST_SAMPLES` do not wait: the oldest ones are then due before their lag is over.

    Args:
        process: What is filtered.
        lag: How long after a sample measurements count for its estimate [s].
    """

    def __init__(self, process: Process, lag: float) -> None:
        self._process, self._lag, self._told = process, lag, -np.inf
        self._samples, self._inputs = list[Filtered](), list[Array | None]()

    def add(self, sample: Filtered, u: Array | None) -> None:
        """Take the newest sample; one at the time of the last one completes that."""
        if self._samples and sample.belief.t <= self._samples[-1].belief.t + _COINCIDENT:
            self._samples[-1] = self._samples[-1]._replace(belief=sample.belief)
            self._inputs[-1] = u
        elif sample.belief.t > self._told + _COINCIDENT:
            self._samples.append(sample)
            self._inputs.append(u)

    def back_to(self, t: float) -> None:
        """Forget samples after a time [s]: they are taken again."""
        while self._samples and self._samples[-1].belief.t > t + _COINCIDENT:
            del self._samples[-1], self._inputs[-1]

    def due(self) -> list[Delayed]:
        """Estimates of the samples whose lag is over, in the order of time, each once."""
        if not self._samples:
            return []
        end = self._samples[-1].belief.t - self._lag + _COINCIDENT
        count = sum(sample.belief.t <= end for sample in self._samples)
        count = max(count, len(self._samples) - MOST_SAMPLES)
        if not count:
            return []
        self._told = self._samples[count - 1].belief.t
        pairs = zip(smoothed(self._process, self._samples), self._inputs, strict=True)
        found = [Delayed(belief, u) for belief, u in pairs][:count]
        del self._samples[:count], self._inputs[:count]
        return found
