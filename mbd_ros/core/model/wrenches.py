"""Samples of measured loads on bodies."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, WrenchSamples


def at_stamps(samples: WrenchSamples, stamps: NDArray[np.int64], max_age: int) -> Array:
    """A recorded load at the stamps of a motion, as `WrenchBuffer.at` gives it.

    Args:
        samples: The recording.
        stamps: Times [ns], shape (n,).
        max_age: How long the newest sample stands for later times [ns].

    Returns:
        Wrenches, shape (n, 6); NaN where no sample is near enough.
    """
    begin = samples.stamps[0]  # differences are exact as floats, times since 1970 are not
    times, known = stamps - begin, samples.stamps - begin
    columns = [np.interp(times, known, column) for column in samples.wrench.T]
    wrench = np.column_stack(columns)
    wrench[(stamps < samples.stamps[0]) | (stamps > samples.stamps[-1] + max_age)] = np.nan
    return wrench


class WrenchBuffer:
    """The newest samples of one load, to be read at the stamps of joint states.

    Args:
        max_age: How long the newest sample stands for later times [ns].
        rewind: A stamp older than the last by more than this is a new beginning [ns].
        length: Samples kept.
    """

    def __init__(self, max_age: int, rewind: int, length: int = 256) -> None:
        self._max_age, self._rewind = max_age, rewind
        self._samples: deque[tuple[int, Array]] = deque(maxlen=length)

    def add(self, stamp: int, wrench: Array) -> bool:
        """Keep a sample; False if its stamp [ns] is not newer than the last one."""
        if self._samples and stamp <= self._samples[-1][0]:
            if self._samples[-1][0] - stamp <= self._rewind:
                return False
            self.clear()
        self._samples.append((stamp, wrench))
        return True

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()

    def covers(self, stamp: int) -> bool:
        """Whether no later sample can change what `at` gives."""
        return bool(self._samples) and self._samples[-1][0] >= stamp

    def at(self, stamp: int) -> Array | None:
        """Wrench at a time: interpolated between samples, held after the newest for `max_age`.

        Args:
            stamp: Time [ns].

        Returns:
            Force [N] then torque [N·m], shape (6,), or None where no sample is near enough.
        """
        later: tuple[int, Array] | None = None
        for sample in reversed(self._samples):
            if sample[0] <= stamp:
                return self._between(sample, later, stamp)
            later = sample
        return None

    def _between(
        self, before: tuple[int, Array], after: tuple[int, Array] | None, stamp: int
    ) -> Array | None:
        age = stamp - before[0]
        if age == 0:
            return before[1]
        if after is None:
            return before[1] if age <= self._max_age else None
        share = age / (after[0] - before[0])
        return before[1] + share * (after[1] - before[1])
