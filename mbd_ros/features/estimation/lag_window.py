"""Samples of a filter whose estimates wait for what is measured a while later."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.estimation.estimator import Belief
from mbd_ros.core.estimation.process import Process
from mbd_ros.core.estimation.smoother import Filtered, smoothed
from mbd_ros.core.state import Array

_SAME = 1.0e-9  # s


class Delayed(NamedTuple):
    """The estimate of a sample by all that was measured until its lag was over.

    Attributes:
        belief: The estimate; its innovation is that of the filter.
        u: Inputs until then, None without.
    """

    belief: Belief
    u: Array | None


class LagWindow:
    """The newest samples, for estimates with a fixed lag: see `smoother`.

    Args:
        process: What is filtered.
        lag: How long after a sample measurements count for its estimate [s].
    """

    def __init__(self, process: Process, lag: float) -> None:
        self._process, self._lag, self._told = process, lag, -np.inf
        self._samples, self._inputs = list[Filtered](), list[Array | None]()

    def add(self, sample: Filtered, u: Array | None) -> None:
        """Take the newest sample; one at the time of the last one completes that."""
        if self._samples and sample.belief.t <= self._samples[-1].belief.t + _SAME:
            self._samples[-1] = self._samples[-1]._replace(belief=sample.belief)
            self._inputs[-1] = u
        elif sample.belief.t > self._told + _SAME:
            self._samples.append(sample)
            self._inputs.append(u)

    def back_to(self, t: float) -> None:
        """Forget samples after a time [s]: they are taken again."""
        while self._samples and self._samples[-1].belief.t > t + _SAME:
            del self._samples[-1], self._inputs[-1]

    def due(self) -> list[Delayed]:
        """Estimates of the samples whose lag is over, in the order of time, each once."""
        if not self._samples:
            return []
        end = self._samples[-1].belief.t - self._lag + _SAME
        count = sum(sample.belief.t <= end for sample in self._samples)
        if not count:
            return []
        self._told = self._samples[count - 1].belief.t
        pairs = zip(smoothed(self._process, self._samples), self._inputs, strict=True)
        found = [Delayed(belief, u) for belief, u in pairs][:count]
        del self._samples[:count], self._inputs[:count]
        return found
