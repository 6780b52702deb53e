"""Faults of mechanisms, of sensors and of the model of an estimator.

Which change of a mechanism explains the efforts that its model does not predict? An unknown effort
d on the disturbed joints is estimated. If hypothesis h were true, this effort would be d_h, with
R d_h = a_h - a for the accelerations of both models. The unexplained share

    sum |d - d_h|^2 / sum |d|^2

over the newest samples is near 0 for the right hypothesis, and near 1 for one that explains
nothing.

`SensorFaults` detects sensors that freeze, jump or become silent. `InnovationWatch` tests whether
innovations are those of a right model. `Cusum` detects residuals with a lasting offset.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.methods.estimation.kalman_update import Bools, Innovation
from mbd_ros.methods.estimation.process import SensorSet

_MOST_UNEXPLAINED = 0.6  # unexplained share above which no hypothesis is named
_LAG = 0.1  # longest delay of an estimate, as a share of the window
_DELAYS = 8  # that are compared
_PAUSE = 0.05  # share of the window between two comparisons
_DENSEST = 50_000  # samples of a window: samples that follow too closely are skipped
_FILLED = 0.9  # share of the window that samples must cover
_BETTER = 0.7  # largest ratio of the share of the named hypothesis to that of the second best
_CHECKPOINT_FIELDS = (
    *("_t", "_received_at", "_used_at", "_value", "_repetitions", "_drift", "_peak", "_error"),
    *("_is_frozen", "_is_out", "_was_received"),
)
_FROZEN_GATES = 2.0  # gates: accumulated normalized innovations of a frozen sensor
_FEWEST_STANDING = 5  # equal samples, from which on a sensor may be frozen
BAND_99 = 2.5758293035489004  # of a normal distribution, both sides
_FEWEST_NUMBERS = 50  # numbers, below which no fault is reported


class FaultNaming:
    """Compares hypotheses about a mechanism by the newest samples.

    Args:
        system: The assumed mechanism, with unknown efforts as internal states.
        hypotheses: Name -> the same mechanism with a change.
        joints: Velocity coordinates on which the unknown efforts act.
        window: Time over which samples are compared [s].
        significant: Size of the unknown efforts, in deviations, from which on a hypothesis is
            named.
    """

    def __init__(
        self,
        system: System,
        hypotheses: Mapping[str, System],
        joints: Array,
        window: float = 1.0,
        significant: float = 3.0,
    ) -> None:
        self._system = system
        self._others = dict(hypotheses)
        self._joints = joints
        self._significant = significant
        self._window = window
        self.reset()

    def reset(self) -> None:
        """Discard all samples."""
        self._samples = deque[_Sample]()
        self._compared_at = -math.inf
        self._newest = Diagnosis("", {}, 0.0)

    def add(self, x: State, u: Array | None, unknown_effort: Array, deviation: Array) -> None:
        """Add a sample.

        Args:
            x: Estimated state of all joints.
            u: Inputs.
            unknown_effort: Estimated unknown efforts, shape (k,).
            deviation: Their standard deviations, shape (k,).
        """
        if self._samples and x.t - self._samples[-1].t < self._window / _DENSEST:
            return
        bare = x._replace(z=np.zeros_like(x.z))
        evaluation = self._system.evaluate(bare, u)
        a, unit = evaluation.a.copy(), np.zeros((len(x.v), len(unknown_effort)))
        unit[self._joints, np.arange(len(unknown_effort))] = 1.0
        reply = evaluation.respond(unit)
        expected = [
            np.linalg.lstsq(reply, system.evaluate(bare, u).a - a, rcond=None)[0]
            for system in self._others.values()
        ]
        size = float(np.mean((unknown_effort / np.maximum(deviation, TINY)) ** 2))
        self._samples.append(_Sample(x.t, np.array(unknown_effort), np.array(expected), size))
        while self._samples[0].t < x.t - self._window:
            self._samples.popleft()

    def diagnose(self) -> Diagnosis:
        """Return the best explanation of the newest samples; updated a few times per window."""
        samples = self._samples
        if len(samples) < 2 or samples[-1].t - samples[0].t < _FILLED * self._window:
            return Diagnosis("", {}, 0.0)
        if samples[-1].t - self._compared_at >= _PAUSE * self._window:
            self._compared_at = samples[-1].t
            self._newest = self._compare()
        return self._newest

    def _compare(self) -> Diagnosis:
        samples = self._samples
        d = np.array([sample.unknown_effort for sample in samples])
        expected = np.array([sample.expected for sample in samples])
        shares = dict(zip(self._others, _unexplained(d, expected).tolist(), strict=True))
        size = math.sqrt(sum(sample.size for sample in samples) / len(samples))
        ranked = sorted(shares, key=lambda name: shares[name])
        is_clear = len(ranked) < 2 or shares[ranked[0]] <= _BETTER * shares[ranked[1]]
        is_distinct = bool(ranked) and shares[ranked[0]] <= _MOST_UNEXPLAINED and is_clear
        name = ranked[0] if is_distinct and size > self._significant else ""
        return Diagnosis(name, shares, size)


class _Sample(NamedTuple):
    """Time, unknown efforts, those of the hypotheses, shape (h, k), and size in deviations."""

    t: float
    unknown_effort: Array
    expected: Array
    size: float


class Diagnosis(NamedTuple):
    """Explanation of the unknown efforts.

    Attributes:
        name: Name of the hypothesis; empty where none or several explain them.
        shares: Hypothesis -> unexplained share.
        size: Root mean square of the unknown efforts over their deviation.
    """

    name: str
    shares: Mapping[str, float]
    size: float


def _unexplained(d: Array, expected: Array) -> Array:
    """Return the unexplained share of each hypothesis at its best delay, shape (h,).

    The estimate of an effort is delayed, depending on the accuracy of the sensors.

    Args:
        d: Unknown efforts, shape (n, k).
        expected: Efforts of the hypotheses, shape (n, h, k).
    """
    n = len(d)
    shares = []
    for delay in range(0, max(1, round(_LAG * n)), max(1, round(_LAG * n / _DELAYS))):
        late = d[delay:]
        error = ((late[:, None] - expected[: n - delay]) ** 2).sum(axis=(0, 2))
        shares.append(error / max(float((late**2).sum()), TINY))
    return np.min(shares, axis=0)


class SensorFaults:
    """Detects faults of every number of the sensors.

    A number jumps if its innovation changes from one sample to the next by more than noise and
    unforeseen accelerations allow. It is not used until it fits again.

    Args:
        gate: Change of an innovation that noise may cause, in deviations.
        agility: Accelerations that inputs do not explain [rad/s^2 or m/s^2].
        patience: Time after which an unused number is a fault [s].
        max_age: Time after which a missing number is a fault [s].

    Attributes:
        names: Names of the numbers.
    """

    def __init__(
        self, sensors: SensorSet, gate: float, agility: float, patience: float, max_age: float
    ) -> None:
        self.names = sensors.names
        self._gate = gate
        self._agility = agility
        self._patience = patience
        self._max_age = max_age
        self._level = np.zeros(sensors.m, dtype=np.int64)
        for sensor, columns in zip(sensors.sensors, sensors.slices, strict=True):
            self._level[columns] = sensor.level
        self.reset(0.0)

    def reset(self, t: float) -> None:
        """Restart at a time [s]."""
        m = len(self.names)
        self._t = t
        self._received_at = np.full(m, t)
        self._used_at = np.full(m, t)
        self._value = np.full(m, np.nan)
        self._repetitions = np.zeros(m, dtype=np.int64)
        self._drift = np.zeros(m)
        self._peak = np.zeros(m)
        self._error = np.full(m, np.nan)
        self._was_received = np.zeros(m, dtype=np.bool_)
        self._is_frozen = np.zeros(m, dtype=np.bool_)
        self._is_out = np.zeros(m, dtype=np.bool_)

    def usable(self, values: Array, expected: Array, deviation: Array, dt: float) -> Bools:
        """Return which numbers can be used.

        Args:
            values: Measured values, NaN where there are none, shape (m,).
            expected: Predicted values, shape (m,).
            deviation: Standard deviations of their difference, shape (m,).
            dt: Time since the last sample [s].
        """
        self._find_frozen(values, (values - expected) / deviation)
        foreseen = np.array((0.5 * dt * dt, dt, 1.0, np.inf))[self._level] * self._agility
        error, most = values - expected, self._gate * deviation + foreseen
        is_measured = np.isfinite(values)
        with np.errstate(invalid="ignore"):
            jumped = np.abs(error - self._error) > most
            fits = np.abs(error) <= most
        self._is_out = np.where(is_measured, (self._is_out | jumped) & ~fits, self._is_out)
        self._error = np.where(is_measured, error, self._error)
        usable: Bools = is_measured & ~self._is_frozen & ~self._is_out
        return usable

    def _find_frozen(self, values: Array, error: Array) -> None:
        """Detect values that stand still while predictions keep moving away to one side."""
        is_measured = np.isfinite(values)
        same = is_measured & (values == self._value)
        changed = is_measured & ~same
        self._repetitions = np.where(
            same, self._repetitions + 1, np.where(changed, 0, self._repetitions)
        )
        drift = np.where(same, self._drift + error, self._drift)
        self._drift = np.where(changed, 0.0, drift)
        self._peak = np.where(changed, 0.0, np.fmax(self._peak, np.abs(drift)))
        self._value = np.where(is_measured, values, self._value)
        moves = (self._peak > _FROZEN_GATES * self._gate) & (self._repetitions >= _FEWEST_STANDING)
        self._is_frozen = (self._is_frozen | (same & moves)) & ~changed

    def note(self, t: float, values: Array, innovation: Innovation) -> None:
        """Record which numbers of a sample were measured and used."""
        self._t = t
        is_measured = np.isfinite(values)
        self._received_at = np.where(is_measured, t, self._received_at)
        self._was_received = self._was_received | is_measured
        self._used_at = np.where(innovation.used, t, self._used_at)

    def refused(self) -> Bools:
        """Return which numbers were measured but unused for too long, shape (m,)."""
        late = self._t - self._used_at > self._patience
        refused: Bools = late & (self._received_at > self._used_at) & ~self._is_frozen
        return refused

    def active_faults(self) -> dict[str, str]:
        """Return the faults: number -> description."""
        faults = dict[str, str]()
        for i, name in enumerate(self.names):
            if self._is_frozen[i]:
                faults[name] = "frozen"
            elif not self._was_received[i]:
                continue  # a number that never came may have no publisher
            elif self._t - self._received_at[i] > self._max_age:
                faults[name] = f"silent for {self._t - self._received_at[i]:.3g} s"
            elif self._t - self._used_at[i] > self._patience:
                faults[name] = f"jumped, does not fit for {self._t - self._used_at[i]:.3g} s"
        return faults

    def checkpoint(self) -> Mapping[str, Any]:
        """Return all that later results depend on; its arrays are never written to."""
        fields = self.__dict__
        return {name: fields[name] for name in _CHECKPOINT_FIELDS}

    def restore(self, checkpoint: Mapping[str, Any]) -> None:
        """Restore a state that `checkpoint` returned."""
        for name, value in checkpoint.items():
            setattr(self, name, value)


class InnovationWatch:
    """Tests whether the newest innovations are those of a right model, by size and whiteness.

    For a right model the normalized innovation squared (NIS) is chi-squared, so that its mean over
    N samples of m numbers is 1 +- z sqrt(2 / (N m)). Normalized innovations do not depend on
    earlier ones: their correlation is 0 +- z / sqrt(N m).

    Source: Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation, 2001, sec. 5.4.

    Args:
        samples: Number of samples in the statistics.
        band: Accepted deviations of a normal distribution.
    """

    def __init__(self, samples: int = 1000, band: float = BAND_99) -> None:
        self.samples = samples
        self.band = band
        self._last: Array | None = None
        self.reset()

    def reset(self) -> None:
        """Discard all innovations."""
        self._terms = deque[Array]()
        self._sums = np.zeros(5)
        self._last = None

    def add(self, innovation: Innovation) -> None:
        """Add the innovation of a sample; one that is not finite is ignored."""
        if not innovation.freedom or not math.isfinite(innovation.squared):
            return
        normalized, last = np.where(innovation.used, innovation.normalized, 0.0), self._last
        product = size = pairs = 0.0
        if last is not None:
            both = innovation.used & (last != 0.0)
            product = float(normalized.dot(last))
            size = 0.5 * float(((normalized * normalized + last * last) * both).sum())
            pairs = float(np.count_nonzero(both))
        term = np.array((innovation.squared, innovation.freedom, product, size, pairs))
        if not np.isfinite(term).all():
            return
        self._last = normalized
        self._terms.append(term)
        self._sums += term
        if len(self._terms) > self.samples:
            self._sums -= self._terms.popleft()

    def consistency(self) -> Consistency:
        """Return the statistics of the innovations."""
        square, count, product, size, pairs = self._sums.tolist()
        numbers = max(round(count), 1)
        half = self.band * math.sqrt(2.0 / numbers)
        correlation = product / size if size > 0.0 else 0.0
        band = self.band / math.sqrt(max(pairs, 1.0))
        nis = max(square, 0.0) / numbers
        return Consistency(nis, (1.0 - half, 1.0 + half), correlation, band, round(count))


class Consistency(NamedTuple):
    """Statistics of the newest innovations.

    Attributes:
        nis: Mean of the normalized innovation squared per number; 1 for a right model.
        nis_band: Range of `nis` for a right model.
        correlation: Correlation of a sample with the one before; 0 for a right model.
        correlation_band: Largest absolute correlation for a right model.
        numbers: Number of innovations.
    """

    nis: float
    nis_band: tuple[float, float]
    correlation: float
    correlation_band: float
    numbers: int

    @property
    def fault(self) -> str:
        """Description of the fault; empty without one."""
        if self.numbers < _FEWEST_NUMBERS:
            return ""
        low, high = self.nis_band
        if self.nis > high:
            return f"innovations are larger than their covariance says: {self.nis:.3g} times"
        if self.nis < low:
            return f"innovations are smaller than their covariance says: {self.nis:.3g} times"
        if abs(self.correlation) > self.correlation_band:
            return f"innovations are not white: correlation {self.correlation:.3g}"
        return ""


class Cusum:
    """Detects offsets of numbers with mean 0 and deviation 1, by two-sided cumulative sums.

        g+ = max(0, g+ + e - k),   g- = max(0, g- - e - k),   alarm if either exceeds h

    Source: E. S. Page, Biometrika 41 (1954) 100.

    Args:
        names: Names of the numbers.
        allowance: k, half of the smallest offset to be detected, in deviations.
        threshold: h, in deviations.
        jump: A larger number is an alarm by itself.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        allowance: float = 1.0,
        threshold: float = 30.0,
        jump: float = 10.0,
    ) -> None:
        self.names = names
        self._k = allowance
        self._h = threshold
        self._jump = jump
        self.reset()

    def reset(self) -> None:
        """Restart the sums."""
        self._sums = np.zeros((2, len(self.names)))
        self._newest = np.zeros(len(self.names))

    def add(self, normalized: Array) -> None:
        """Add residuals over their deviations, NaN where there are none, shape (n,)."""
        is_measured = np.nan_to_num(normalized)
        self._newest = is_measured
        both = np.array((is_measured, -is_measured)) - self._k
        raised = np.maximum(0.0, self._sums + np.where(np.isfinite(normalized), both, 0.0))
        self._sums = np.minimum(raised, 2.0 * self._h)  # so that an alarm ends with its cause

    def alarms(self) -> dict[str, str]:
        """Return the alarms: number -> description."""
        alarms = dict[str, str]()
        for i, name in enumerate(self.names):
            over, under = self._sums[:, i].tolist()
            if abs(self._newest[i]) > self._jump:
                alarms[name] = f"off by {self._newest[i]:.3g} deviations"
            elif max(over, under) > self._h:
                alarms[name] = "too large for long" if over > under else "too small for long"
        return alarms
