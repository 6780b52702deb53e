"""How much a stream of commands chatters."""

import math
from typing import Annotated

import numpy as np

from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.state import Array


class ChatterMeter:
    """Mean square of commands above a frequency, forgotten exponentially.

    Commands u are held until the next one. A critically damped high-pass of second order,

        h = (s / (s + w))^2 u,   w = 2 pi f / sqrt(1 + sqrt 2)

    with half power at f leaves a motion at 0.1 f with 6e-4 of its power; chatter passes. Then

        T E' = h^2 - E

    Both are integrated exactly over every hold, so that E does not depend on how a constant
    command is divided into samples. A command counts once it has acted, that is, from the next
    update on.

    Args:
        size: Number of joints.
        cutoff: Frequency f from which motion of a command counts as chatter; arm and leg
            movements stay below 10 Hz.
        memory: T, > 0.

    Attributes:
        energy: E of each joint [(N·m)^2 or N^2], shape (n,); a new array each update.

    Source: the steps are the variation of constants of the two filters.
    """

    def __init__(
        self,
        size: int,
        cutoff: Annotated[float, Within(1.0e-3, 1.0e6), Unit("Hz")] = 20.0,
        memory: Annotated[float, Unit("s")] = 0.5,
    ) -> None:
        self._w = 2.0 * math.pi * cutoff / math.sqrt(1.0 + math.sqrt(2.0))
        self._memory = memory
        self._dt, self._factors = -1.0, (1.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self._first, self._second = np.zeros(size), np.zeros(size)  # u - first, less second, is h
        self._u = np.zeros(size)
        self.reset()

    @property
    def rms(self) -> Array:
        """Square root of `energy` [N·m or N], shape (n,)."""
        return np.sqrt(self.energy)

    @property
    def total(self) -> float:
        """Energy of all joints; of use where they have one unit [(N·m)^2 or N^2]."""
        return float(self.energy.sum())

    def reset(self) -> None:
        """Forget the past; the next command counts as held for ever."""
        self.energy: Array = np.zeros(len(self._u))
        self._is_new = True

    def update(self, u: Array, dt: float) -> None:
        """Take a new command.

        Args:
            u: [N·m or N], finite, shape (n,).
            dt: Time since the last one [s]; what is < 0 counts as 0.
        """
        if self._is_new:
            self._first[:], self._second[:], self._is_new = u, 0.0, False
        elif dt > 0.0:
            self._advance(dt)
        self._u[:] = u

    def _advance(self, dt: float) -> None:
        """Hold the last command for a time: h = exp(-w t) (h0 - w t d), d = u - first at 0."""
        if dt != self._dt:
            self._dt, self._factors = dt, self._factors_of(dt)
        decay, ramp, kept, square, cross, slope = self._factors
        d = self._u - self._first
        h = d - self._second
        self.energy = kept * self.energy + square * (h * h) - cross * (h * d) + slope * (d * d)
        self._first += (1.0 - decay) * d
        self._second *= decay
        self._second += ramp * d

    def _factors_of(self, dt: float) -> tuple[float, float, float, float, float, float]:
        """Decay of d, its share in `second`, and E+ as a form in E, h0 and d.

        E+ = e^{-dt/T} E + 1/T integral of e^{-(dt-t)/T} e^{-2wt} (h0 - wtd)^2 over [0, dt]; the
        substitution t = dt x leaves moments of e^{-ax} with a = (2w - 1/T) dt.
        """
        wt, forget = self._w * dt, dt / self._memory
        decay, kept = math.exp(-wt), math.exp(-forget)
        m0, m1, m2 = (forget * m for m in _moments(2.0 * wt - forget, kept, decay * decay))
        return decay, decay * wt, kept, m0, 2.0 * wt * m1, wt * wt * m2


def _moments(a: float, start: float, end: float) -> tuple[float, float, float]:
    """Integrals of x^k start exp(-a x) over [0, 1], k = 0, 1, 2; it ends at `end`."""
    if abs(a) < 1.0:  # the closed forms cancel: x^k exp(-a x) as a series
        terms = [start * (-a) ** j / math.factorial(j) for j in range(20)]
        sums = (sum(t / (j + k + 1) for j, t in enumerate(terms)) for k in range(3))
        return next(sums), next(sums), next(sums)
    m0 = (start - end) / a
    m1 = (m0 - end) / a
    return m0, m1, (2.0 * m1 - end) / a
