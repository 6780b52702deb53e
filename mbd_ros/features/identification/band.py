"""The band in which a motion shows its masses, and the filter that keeps it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

_SHARE = 0.999  # of the energy of a velocity, which lies below the frequency of the motion
_ABOVE = 5.0  # of that frequency: where the band ends; products of sines are in it
_GRID = 20.0  # samples for a period of the end of the band: friction changes sign within one
_KEPT = 2.5  # the same, of what is left when the band is all that there is
_HALF_LENGTH = 1.5  # periods of the end of the band on either side of a sample of the filter
HIGHEST = 0.2  # of the sampling rate: where a band ends at the latest


def band_of(times: Array, velocity: Array) -> float:
    """Where the band of a motion ends [Hz].

    Args:
        times: [s], shape (n,).
        velocity: Of the joints [rad/s or m/s], shape (n, m).
    """
    rate = 1.0 / float(np.median(np.diff(times)))
    n = len(times)
    taper = np.hanning(n)[:, None]
    energy = np.square(np.abs(np.fft.rfft((velocity - velocity.mean(axis=0)) * taper, axis=0)))
    frequency = np.fft.rfftfreq(n, 1.0 / rate)
    total = energy.sum(axis=0)
    moving = np.sqrt(total) > 1e-6 * np.sqrt(total.max(initial=0.0))
    if not (moving.any() and total.max() > 0.0):
        return HIGHEST * rate
    below = np.cumsum(energy[:, moving], axis=0) / total[moving]
    own = [frequency[np.searchsorted(b, _SHARE)] for b in below.T]
    lowest = 1.0 / (times[-1] - times[0])
    return float(min(_ABOVE * max(*own, lowest), HIGHEST * rate))


class Filter(NamedTuple):
    """Zero-phase low-pass with decimation: rows of a sparse matrix, one for each sample kept.

    Attributes:
        taps: Weights of a window of samples, sum 1, shape (l,).
        step: Samples from one window to the next.
    """

    taps: Array
    step: int

    @classmethod
    def of(cls, rate: float, band: float) -> "Filter":
        """The filter of a band.

        Args:
            rate: Of the samples [Hz].
            band: Its end [Hz].

        Source: A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 2010, section
            7.5 (windowed sinc, Hamming).
        """
        half = int(np.ceil(_HALF_LENGTH * rate / band))
        at = np.arange(-half, half + 1)
        taps = np.sinc(2.0 * band / rate * at) * np.hamming(2 * half + 1)
        return cls(taps / taps.sum(), max(int(rate / (_KEPT * band)), 1))

    @property
    def correlation(self) -> Array:
        """Of white noise behind it, of samples kept so many apart, 1 first, shape (k,)."""
        lags = range(0, len(self.taps), self.step)
        found = np.array([self.taps[: len(self.taps) - lag] @ self.taps[lag:] for lag in lags])
        return np.asarray(found / found[0])

    def starts(self, count: int) -> NDArray[np.intp]:
        """First samples of the windows in a piece of so many samples."""
        return np.arange(0, count - len(self.taps) + 1, self.step)

    def passed(self, values: Array) -> Array:
        """Samples of a piece through the filter: shape (windows, ..) of values (n, ..)."""
        starts = self.starts(len(values))
        flat = values.reshape(len(values), -1)
        found = np.empty((len(starts), flat.shape[1]))
        size = max(8 * len(self.taps), 256)  # samples of a dense block of the matrix
        count = max((size - len(self.taps)) // self.step + 1, 1)
        for first in range(0, len(starts), count):
            some = starts[first : first + count]
            begin, end = some[0], some[-1] + len(self.taps)
            block = np.zeros((len(some), end - begin))
            for row, start in zip(block, some - begin, strict=True):
                row[start : start + len(self.taps)] = self.taps
            found[first : first + count] = block @ flat[begin:end]
        return found.reshape(len(starts), *values.shape[1:])


def grid_step(rate: float, band: float) -> int:
    """Every how many samples the regressor is asked for."""
    return max(int(rate / (_GRID * band)), 1)
