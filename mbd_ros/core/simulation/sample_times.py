"""When the samples of a run are due."""

import math
from typing import NamedTuple

from mbd_ros.core.state import State
from mbd_ros.core.thresholds import SAME_TIME


class SampleTimes(NamedTuple):
    """When the samples of a run are due.

    Attributes:
        origin: Time of the first one [s].
        dt: Interval [s].
        last: Time of the last one [s].
        end: Number of the last one; the first is 0.
        resolution: How finely times are told apart this late [s].
        slack: Times that are as near as this are the same [s].
    """

    origin: float
    dt: float
    last: float
    end: int
    resolution: float
    slack: float

    def due(self, sample: int) -> float:
        """Time of a sample [s]."""
        return min(self.origin + sample * self.dt, self.last)


def sample_times(origin: float, duration: float, dt: float) -> SampleTimes:
    """Those of a run from `origin` on; a last shorter interval ends exactly at its end."""
    last, end = origin + duration, math.ceil(duration / dt - SAME_TIME)
    resolution = 2.0 * math.ulp(max(abs(origin), abs(last)))
    return SampleTimes(origin, dt, last, end, resolution, max(SAME_TIME * dt, resolution))


def step_end(y: State, sample: int, times: SampleTimes, now: float, is_fixed: bool) -> float:
    """Time that the step after a sample should not pass, so that samples are n dt apart."""
    here = times.origin + sample * times.dt
    late = abs(here - y.t)
    is_rounded = late > 0.2 * times.slack or is_fixed  # a sum of steps, to be put right
    is_off = now > here + times.slack  # back to the samples
    is_next = (is_rounded and late < 1.0e3 * times.slack) or is_off
    return times.due(sample + 1) if is_next else times.last
