"""Faults of mechanisms, of sensors and of the model that an estimator has.

Which change of a mechanism explains the efforts that its model lacks? An unknown effort d on the
disturbed joints is estimated. Were the mechanism that of hypothesis h, the lacking effort would be
d_h, with the accelerations R d_h = a_h - a of both models. The share

    sum |d - d_h|^2 / sum |d|^2

over the last samples is near 0 for what is the case, near 1 for what explains nothing.

`SensorFaults` tells which sensor stands, jumps or is silent, `InnovationWatch` whether innovations
are those of a right model, and `Cusum` which residuals are off for long.
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

_MOST_UNEXPLAINED = 0.6  # share of what is not explained, above which nothing is named
_LAG = 0.1  # longest delay of an estimate, as a share of the window
_DELAYS = 8  # that are tried
_PAUSE = 0.05  # share of the window between two comparisons
_DENSEST = 50_000  # samples of a window: what follows another one too closely does not count
_FILLED = 0.9  # share of the window that samples must cover
_BETTER = 0.7  # times the share of the second best that a named one has at most
_MEMORY_FIELDS = (
    *("_t", "_heard", "_counted", "_value", "_stood", "_pushed", "_peak", "_error"),
    *("_is_frozen", "_is_out", "_came"),
)
_FROZEN_GATES = 2.0  # gates, of normalised innovations added up
_FEWEST_STANDING = 5  # samples with one value, from which on it may be a frozen sensor
BAND_99 = 2.5758293035489004  # of a normal distribution, both sides
_FEWEST_NUMBERS = 50  # numbers, below which nothing is said


class FaultNaming:
    """Compares hypotheses by the last samples.

    Args:
        system: The mechanism as it is thought to be, with unknown efforts as internal states.
        hypotheses: Name -> the same mechanism with something else in it.
        joints: Velocity coordinates on which the unknown efforts act.
        window: Time over which samples are compared [s].
        significant: Size of the lacking efforts, in deviations, below which nothing is named.
    """

    def __init__(
        self,
        system: System,
        hypotheses: Mapping[str, System],
        joints: Array,
        window: float = 1.0,
        significant: float = 3.0,
    ) -> None:
        self._system, self._others, self._joints = system, dict(hypotheses), joints
        self._significant, self._window = significant, window
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._samples = deque[_Sample]()
        self._looked, self._newest = -math.inf, Named("", {}, 0.0)

    def add(self, x: State, u: Array | None, lacking: Array, deviation: Array) -> None:
        """Take a sample.

        Args:
            x: Estimated state of all joints.
            lacking: Unknown efforts, shape (k,).
            deviation: Their standard deviations, shape (k,).
        """
        if self._samples and x.t - self._samples[-1].t < self._window / _DENSEST:
            return
        bare = x._replace(z=np.zeros_like(x.z))
        found = self._system.evaluate(bare, u)
        a, unit = found.a.copy(), np.zeros((len(x.v), len(lacking)))
        unit[self._joints, np.arange(len(lacking))] = 1.0
        reply = found.respond(unit)
        expected = [
            np.linalg.lstsq(reply, system.evaluate(bare, u).a - a, rcond=None)[0]
            for system in self._others.values()
        ]
        size = float(np.mean((lacking / np.maximum(deviation, TINY)) ** 2))
        self._samples.append(_Sample(x.t, np.array(lacking), np.array(expected), size))
        while self._samples[0].t < x.t - self._window:
            self._samples.popleft()

    def named(self) -> Named:
        """What explains the last samples best; looked for anew a few times a window."""
        samples = self._samples
        if len(samples) < 2 or samples[-1].t - samples[0].t < _FILLED * self._window:
            return Named("", {}, 0.0)
        if samples[-1].t - self._looked >= _PAUSE * self._window:
            self._looked, self._newest = samples[-1].t, self._compared()
        return self._newest

    def _compared(self) -> Named:
        samples = self._samples
        d = np.array([sample.lacking for sample in samples])
        expected = np.array([sample.expected for sample in samples])
        shares = dict(zip(self._others, _unexplained(d, expected).tolist(), strict=True))
        size = math.sqrt(sum(sample.size for sample in samples) / len(samples))
        ranked = sorted(shares, key=lambda name: shares[name])
        is_clear = len(ranked) < 2 or shares[ranked[0]] <= _BETTER * shares[ranked[1]]
        is_told = bool(ranked) and shares[ranked[0]] <= _MOST_UNEXPLAINED and is_clear
        name = ranked[0] if is_told and size > self._significant else ""
        return Named(name, shares, size)


class _Sample(NamedTuple):
    """Time, lacking efforts, those of the hypotheses, shape (h, k), size in deviations."""

    t: float
    lacking: Array
    expected: Array
    size: float


class Named(NamedTuple):
    """What explains the efforts that are lacking.

    Attributes:
        name: Of the hypothesis; empty where none does, or several do.
        shares: Hypothesis -> what it leaves unexplained.
        size: Root mean square of the lacking efforts over what can be told from noise.
    """

    name: str
    shares: Mapping[str, float]
    size: float


def _unexplained(d: Array, expected: Array) -> Array:
    """Share that each hypothesis leaves, at the delay that suits it best, shape (h,).

    An estimate of an effort lags behind it, the more the less a sensor says of it.

    Args:
        d: Lacking efforts, shape (n, k).
        expected: Those of the hypotheses, shape (n, h, k).
    """
    n = len(d)
    found = []
    for delay in range(0, max(1, round(_LAG * n)), max(1, round(_LAG * n / _DELAYS))):
        late = d[delay:]
        left = ((late[:, None] - expected[: n - delay]) ** 2).sum(axis=(0, 2))
        found.append(left / max(float((late**2).sum()), TINY))
    return np.min(found, axis=0)


class SensorFaults:
    """Watches every number of the sensors.

    A number jumps where its innovation changes, from one sample to the next, by more than noise
    and unforeseen accelerations can do. It does not count until it fits again.

    Args:
        gate: Deviations of its innovation that noise may bring.
        agility: Accelerations that nobody foresees and that happen all the same [rad/s^2, m/s^2].
        patience: Time after which a number that did not count is a fault [s].
        max_age: Time after which one that did not come is a fault [s].

    Attributes:
        names: Of the numbers.
    """

    def __init__(
        self, sensors: SensorSet, gate: float, agility: float, patience: float, max_age: float
    ) -> None:
        self.names, self._gate, self._agility = sensors.names, gate, agility
        self._patience, self._max_age = patience, max_age
        self._level = np.zeros(sensors.m, dtype=np.int64)
        for sensor, mine in zip(sensors.sensors, sensors.slices, strict=True):
            self._level[mine] = sensor.level
        self.forget(0.0)

    def forget(self, t: float) -> None:
        """Begin anew at a time [s]."""
        m = len(self.names)
        self._t = t
        self._heard, self._counted = np.full(m, t), np.full(m, t)
        self._value, self._stood = np.full(m, np.nan), np.zeros(m, dtype=np.int64)
        self._pushed, self._peak, self._error = np.zeros(m), np.zeros(m), np.full(m, np.nan)
        self._came = np.zeros(m, dtype=np.bool_)
        self._is_frozen, self._is_out = np.zeros((2, m), dtype=np.bool_)

    def usable(self, values: Array, expected: Array, deviation: Array, dt: float) -> Bools:
        """Which numbers may count.

        Args:
            values: Measured, NaN where nothing came, shape (m,).
            expected: Predicted, shape (m,).
            deviation: Of their difference, shape (m,).
            dt: Since the last sample [s].
        """
        self._find_frozen(values, (values - expected) / deviation)
        foreseen = np.array((0.5 * dt * dt, dt, 1.0, np.inf))[self._level] * self._agility
        error, most = values - expected, self._gate * deviation + foreseen
        told = np.isfinite(values)
        with np.errstate(invalid="ignore"):
            jumped = np.abs(error - self._error) > most
            fits = np.abs(error) <= most
        self._is_out = np.where(told, (self._is_out | jumped) & ~fits, self._is_out)
        self._error = np.where(told, error, self._error)
        usable: Bools = told & ~self._is_frozen & ~self._is_out
        return usable

    def _find_frozen(self, values: Array, error: Array) -> None:
        """What is the same for long, while predictions keep moving away from it to one side."""
        told = np.isfinite(values)
        same = told & (values == self._value)
        changed = told & ~same
        self._stood = np.where(same, self._stood + 1, np.where(changed, 0, self._stood))
        pushed = np.where(same, self._pushed + error, self._pushed)
        self._pushed = np.where(changed, 0.0, pushed)
        self._peak = np.where(changed, 0.0, np.fmax(self._peak, np.abs(pushed)))
        self._value = np.where(told, values, self._value)
        moves = (self._peak > _FROZEN_GATES * self._gate) & (self._stood >= _FEWEST_STANDING)
        self._is_frozen = (self._is_frozen | (same & moves)) & ~changed

    def note(self, t: float, values: Array, innovation: Innovation) -> None:
        """Take what counted of a sample."""
        self._t = t
        told = np.isfinite(values)
        self._heard, self._came = np.where(told, t, self._heard), self._came | told
        self._counted = np.where(innovation.used, t, self._counted)

    def refused(self) -> Bools:
        """Which numbers came and did not count for longer than the patience, shape (m,)."""
        late = self._t - self._counted > self._patience
        refused: Bools = late & (self._heard > self._counted) & ~self._is_frozen
        return refused

    def found(self) -> dict[str, str]:
        """Number -> what is wrong with it."""
        faults = dict[str, str]()
        for i, name in enumerate(self.names):
            if self._is_frozen[i]:
                faults[name] = "frozen"
            elif not self._came[i]:
                continue  # nobody has promised it
            elif self._t - self._heard[i] > self._max_age:
                faults[name] = f"silent for {self._t - self._heard[i]:.3g} s"
            elif self._t - self._counted[i] > self._patience:
                faults[name] = f"jumped, does not fit for {self._t - self._counted[i]:.3g} s"
        return faults

    def checkpoint(self) -> Mapping[str, Any]:
        """All that later answers depend on; arrays are never written to."""
        own = self.__dict__
        return {name: own[name] for name in _MEMORY_FIELDS}

    def restore(self, checkpoint: Mapping[str, Any]) -> None:
        """Go back to a checkpoint."""
        for name, value in checkpoint.items():
            setattr(self, name, value)


class InnovationWatch:
    """Whether the newest innovations are those of a right model: their size, and whiteness.

    For a right model the normalised innovation squared (NIS) is chi-squared, so that its mean over
    N samples of m numbers is 1 +- z sqrt(2 / (N m)), and what is normalised does not depend on
    what was before: its correlation with that is 0 +- z / sqrt(N m).

    Source: Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation, 2001, sec. 5.4.

    Args:
        samples: How many are looked at.
        band: Deviations of a normal distribution that are accepted.
    """

    def __init__(self, samples: int = 1000, band: float = BAND_99) -> None:
        self.samples, self.band = samples, band
        self._last: Array | None = None
        self.forget()

    def forget(self) -> None:
        """Forget all innovations."""
        self._terms = deque[Array]()
        self._sums, self._last = np.zeros(5), None

    def add(self, innovation: Innovation) -> None:
        """Take the innovation of a sample; one that is not finite says nothing."""
        if not innovation.freedom or not math.isfinite(innovation.squared):
            return
        now, last = np.where(innovation.used, innovation.normalized, 0.0), self._last
        product = size = pairs = 0.0
        if last is not None:
            both = innovation.used & (last != 0.0)
            product = float(now.dot(last))
            size = 0.5 * float(((now * now + last * last) * both).sum())
            pairs = float(np.count_nonzero(both))
        term = np.array((innovation.squared, innovation.freedom, product, size, pairs))
        if not np.isfinite(term).all():
            return
        self._last = now
        self._terms.append(term)
        self._sums += term
        if len(self._terms) > self.samples:
            self._sums -= self._terms.popleft()

    def consistency(self) -> Consistency:
        """What they say so far."""
        square, count, product, size, pairs = self._sums.tolist()
        numbers = max(round(count), 1)
        half = self.band * math.sqrt(2.0 / numbers)
        correlation = product / size if size > 0.0 else 0.0
        band = self.band / math.sqrt(max(pairs, 1.0))
        nis = max(square, 0.0) / numbers
        return Consistency(nis, (1.0 - half, 1.0 + half), correlation, band, round(count))


class Consistency(NamedTuple):
    """What the innovations of the newest samples say.

    Attributes:
        nis: Mean of the normalised innovation squared a number; 1 for a right model.
        nis_band: Where it should be.
        correlation: Of a sample with the one before; 0 for a right model.
        correlation_band: How far it may be from 0.
        numbers: How many numbers that is.
    """

    nis: float
    nis_band: tuple[float, float]
    correlation: float
    correlation_band: float
    numbers: int

    @property
    def fault(self) -> str:
        """What is wrong, empty where nothing is."""
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
    """Alarms on numbers that should have mean 0 and deviation 1, by two-sided cumulative sums.

        g+ = max(0, g+ + e - k),   g- = max(0, g- - e - k),   alarm where either exceeds h

    Source: E. S. Page, Biometrika 41 (1954) 100.

    Args:
        names: Of the numbers.
        allowance: k, half of the smallest shift that is looked for, in deviations.
        threshold: h, in deviations.
        jump: A number beyond it is an alarm by itself.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        allowance: float = 1.0,
        threshold: float = 30.0,
        jump: float = 10.0,
    ) -> None:
        self.names, self._k, self._h, self._jump = names, allowance, threshold, jump
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._sums = np.zeros((2, len(self.names)))
        self._newest = np.zeros(len(self.names))

    def add(self, normalized: Array) -> None:
        """Take residuals over their deviations, NaN where there is none, shape (n,)."""
        told = np.nan_to_num(normalized)
        self._newest = told
        both = np.array((told, -told)) - self._k
        raised = np.maximum(0.0, self._sums + np.where(np.isfinite(normalized), both, 0.0))
        self._sums = np.minimum(raised, 2.0 * self._h)  # so that an alarm ends with its cause

    def alarms(self) -> dict[str, str]:
        """Number -> what is wrong with it."""
        found = dict[str, str]()
        for i, name in enumerate(self.names):
            over, under = self._sums[:, i].tolist()
            if abs(self._newest[i]) > self._jump:
                found[name] = f"off by {self._newest[i]:.3g} deviations"
            elif max(over, under) > self._h:
                found[name] = "too large for long" if over > under else "too small for long"
        return found
