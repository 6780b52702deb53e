"""Which change of a mechanism explains the efforts that its model lacks.

An unknown effort d on the disturbed joints is estimated. Were the mechanism that of hypothesis h,
the lacking effort would be d_h, with the accelerations R d_h = a_h - a of both models. The share

    sum |d - d_h|^2 / sum |d|^2

over the last samples is near 0 for what is the case, near 1 for what explains nothing.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY

_EXPLAINED = 0.6  # share of what is not explained, above which nothing is named
_LAG, _DELAYS = 0.1, 8  # longest delay, as a share of the window; how many are tried
_PAUSE = 0.05  # share of the window between two comparisons
_FILLED = 0.9  # share of the window that samples must cover
_BETTER = 0.7  # times the share of the second best that a named one has at most


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


_NOTHING = Named("", {}, 0.0)


class _Sample(NamedTuple):
    """Time, lacking efforts, those of the hypotheses, shape (h, k), size in deviations."""

    t: float
    lacking: Array
    expected: Array
    size: float


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
        self._looked, self._newest = -math.inf, _NOTHING

    def add(self, x: State, u: Array | None, lacking: Array, deviation: Array) -> None:
        """Take a sample.

        Args:
            x: Estimated state of all joints.
            u: Inputs.
            lacking: Unknown efforts, shape (k,).
            deviation: Their standard deviations, shape (k,).
        """
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
            return _NOTHING
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
        is_told = bool(ranked) and shares[ranked[0]] <= _EXPLAINED and is_clear
        name = ranked[0] if is_told and size > self._significant else ""
        return Named(name, shares, size)


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
