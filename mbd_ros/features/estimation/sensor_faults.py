"""What is wrong with sensors: what stands while the machine moves, what jumps, what is silent."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbd_ros.core.estimation.kalman_update import Bools, Innovation
from mbd_ros.core.estimation.sensor_set import SensorSet
from mbd_ros.core.state import Array

_KEPT = (
    *("_t", "_heard", "_counted", "_value", "_stood", "_pushed", "_peak", "_error"),
    *("_is_frozen", "_is_out", "_came"),
)
_PUSHES = 2.0  # gates, of normalised innovations added up
_STANDS = 5  # samples with one value, from which on it may be a frozen sensor


class SensorFaults:
    """Watches every number of the sensors.

    A number jumps where its innovation changes, from one sample to the next, by more than noise
    and unforeseen accelerations can do. It does not count until it fits again.

    Args:
        sensors: The sensors.
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
        moves = (self._peak > _PUSHES * self._gate) & (self._stood >= _STANDS)
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

    def remember(self) -> Mapping[str, Any]:
        """All that later answers depend on; arrays are never written to."""
        own = self.__dict__
        return {name: own[name] for name in _KEPT}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go back to what `remember` gave."""
        for name, value in memory.items():
            setattr(self, name, value)
