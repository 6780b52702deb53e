"""What a run remembers at a sample, as a value."""

import math
from typing import NamedTuple

from mbd_ros.core.memory import Memory
from mbd_ros.core.state import State
from mbd_ros.core.thresholds import SAME_TIME


class Progress(NamedTuple):
    """How far a run is.

    Attributes:
        origin: Its first time [s]; samples are at origin + sample dt.
        sample: Number of the newest one; the first is 0.
        y: What is integrated, after the last step.
        is_within: Whether the last step has samples inside that are still to come.
        held_since: When inputs jumped last [s].
    """

    origin: float
    sample: int
    y: State
    is_within: bool
    held_since: float


class Checkpoint(NamedTuple):
    """A simulation at a sample; one of the same scene, method and dt continues with the same bits.

    It holds numbers and arrays only, and can be pickled.

    Attributes:
        made_by: Method, dt [s], and sizes of what is integrated.
        progress: How far the run is.
        steps: Steps taken so far.
        worst: As of the `Simulation`.
        stops: What is known of stops that were passed; empty without stops.
        memory: What the method remembers of earlier steps.
    """

    made_by: tuple[str, float, int, int, int]
    progress: Progress
    steps: int
    worst: tuple[float, float]
    stops: Memory
    memory: Memory


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


def words(method: str, dt: float, nq: int, nv: int, nz: int) -> str:
    """What made a checkpoint, for messages; arguments are `Checkpoint.made_by`."""
    states = f", {nv} velocities and {nz} internal states" if nz else f" and {nv} velocities"
    return f"{method} with dt {dt:g} s, {nq} positions{states}"
