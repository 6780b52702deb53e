"""Whether innovations are those of a right model: their size, and that they are white.

For a right model the normalised innovation squared (NIS) is chi-squared, so that its mean over N
samples of m numbers is 1 +- z sqrt(2 / (N m)), and what is normalised does not depend on what was
before: its correlation with that is 0 +- z / sqrt(N m). Source: Y. Bar-Shalom, X.-R. Li,
T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, sec. 5.4.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from mbd_ros.core.estimation.kalman_update import Innovation
from mbd_ros.core.state import Array

BAND_99 = 2.5758293035489004  # of a normal distribution, both sides
_FEWEST = 50  # numbers, below which nothing is said


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
        if self.numbers < _FEWEST:
            return ""
        low, high = self.nis_band
        if self.nis > high:
            return f"innovations are larger than their covariance says: {self.nis:.3g} times"
        if self.nis < low:
            return f"innovations are smaller than their covariance says: {self.nis:.3g} times"
        if abs(self.correlation) > self.correlation_band:
            return f"innovations are not white: correlation {self.correlation:.3g}"
        return ""


class InnovationWatch:
    """The newest innovations of an estimator.

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
        """Take the innovation of a sample."""
        if not innovation.freedom:
            return
        now, last = np.where(innovation.used, innovation.normalized, 0.0), self._last
        product = size = pairs = 0.0
        if last is not None:
            both = innovation.used & (last != 0.0)
            product = float(now.dot(last))
            size = 0.5 * float(((now * now + last * last) * both).sum())
            pairs = float(np.count_nonzero(both))
        self._last = now
        term = np.array((innovation.squared, innovation.freedom, product, size, pairs))
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
