"""Samples of a run: when they are due, which inputs hold until then, and how a run is resumed.

Samples are at origin + n dt, the last one exactly at the end. Inputs u are held from jump to jump,
and steps end at jumps. A `Checkpoint` is all that the samples after the newest one depend on.
"""

import math
from typing import NamedTuple

from mbd_ros.core.loads.inputs import Sources
from mbd_ros.core.state import Array, Memory, State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import ModelError


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


class HeldInputs:
    """Holds u until its next jump, where a step must end.

    Args:
        sources: What gives u.
        times: Samples of the run: jumps that fall on one are moved there.
        now: When u jumped last, or the start of the run [s].

    Attributes:
        u: Inputs from `now` on; None without sources.
        now: When u jumped last, or the start of the run [s].
        end: Time that the next step must not pass [s]; inf without a jump to come.
    """

    def __init__(self, sources: Sources, times: SampleTimes, now: float) -> None:
        self._sources = sources
        self._times = times
        self._jumps = sources.jumps(now, times.last)
        self._next = next(self._jumps, math.inf)
        self.u: Array | None = None
        self._hold(now)

    def reach(self, t: float) -> None:
        """Hold what is valid from a time [s] on, where a step ended."""
        if t >= self.end:
            self._hold(self.end)

    def _hold(self, now: float) -> None:
        jump = self.now = now
        while self._next <= now + self._times.slack:
            jump = max(jump, self._next)
            self._next = next(self._jumps, math.inf)
        self.u = self._sources.held(jump)
        self.end = self._on_sample(self._next) if self._next < math.inf else math.inf

    def _on_sample(self, jump: float) -> float:
        origin, dt = self._times.origin, self._times.dt
        sample = origin + round((jump - origin) / dt) * dt
        return sample if abs(sample - jump) <= self._times.slack else jump


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


def refuse_other(checkpoint: Checkpoint, made_by: tuple[str, float, int, int, int]) -> None:
    """Refuse a checkpoint of something else.

    Raises:
        ModelError: It is one of another method or dt, or of other sizes.
    """
    if checkpoint.made_by != made_by:
        texts = (_words(*made) for made in (checkpoint.made_by, made_by))
        raise ModelError("a checkpoint of {} cannot be continued by {}".format(*texts))


def _words(method: str, dt: float, nq: int, nv: int, nz: int) -> str:
    """What made a checkpoint, for messages; arguments are `Checkpoint.made_by`."""
    states = f", {nv} velocities and {nz} internal states" if nz else f" and {nv} velocities"
    return f"{method} with dt {dt:g} s, {nq} positions{states}"
