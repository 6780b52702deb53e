"""Samples of a run: when they are due, which inputs hold until then, and how a run is resumed.

Samples are at origin + n dt, the last one exactly at the end. Inputs u are held from jump to jump,
and steps end at jumps. A `Checkpoint` is all that the samples after the newest one depend on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.loads.inputs import Sources
from mbd_ros.core.state import NONE, Array, Memory, State, is_same
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.stepping import BlockStepper, HeldTable, SampleBlock
from mbd_ros.methods.simulation.stall import WINDOW, StallWatch

_FIRST = 64  # samples of the first block
_MOST = 4096  # samples of any block
_ROWS = 65536  # rows of held inputs of a block
Alone = Callable[[State, Array | None, float], State]


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


class SampleBlocks:
    """The samples of a run after the newest one.

    A block is taken at once; what the samples inside it depend on is found by taking the block
    again, up to the sample that is asked for.

    Args:
        stepper: Takes the steps.
        system: What it integrates.
        times: When samples are due.
        at: Where the run stands.
        alone: Takes a step that the stepper does not take in a block, and checks it.
    """

    def __init__(
        self,
        stepper: BlockStepper,
        system: System,
        times: SampleTimes,
        at: Progress,
        alone: Alone,
    ) -> None:
        self.stepper = stepper
        self._times = times
        self._alone = alone
        self._origin = at.origin
        nq, nv = int(system.model.nq), int(system.model.nv)
        self._ends = 1 + nq, 1 + nq + nv  # of q and v in a row
        self._inputs = HeldInputs(system.loads.sources, times, at.held_since)
        self._idle = system.loads.idle
        stepper.begin_samples(at.y, at.sample, is_within=at.is_within)
        self._before: tuple[Memory, HeldTable] | None = None
        self._seen = 0
        self._at = at
        self._end: tuple[HeldTable, int | None] | None = None

    def rows(
        self, watch: StallWatch, most: int = _FIRST, *, is_remembered: bool = False
    ) -> Iterator[Array]:
        """Blocks of samples, as of `SampleBlock.rows`.

        Args:
            watch: Looks at the pace of the steps.
            most: Samples of the first block.
            is_remembered: Whether `remembered` will be asked.
        """
        stepper, times, most = self.stepper, self._times, min(most, _MOST)
        watch.begin(self._at.y.t)
        look_at, since = WINDOW, stepper.taken
        held = self._table(most)
        while stepper.newest < times.end:
            if is_remembered:
                self._before, self._seen = (stepper.checkpoint(), held), 0
            block = stepper.samples(times, held, look_at - (stepper.taken - since), most)
            if len(block.rows):
                yield block.rows
            self._end = held, block.intervals
            if stepper.newest == times.end:
                break
            held = self._left(held, block, most)
            if block.is_stuck:
                self._step_alone(held)
            if stepper.taken - since >= look_at:
                watch.look(stepper.state, held.values[0], times.last)
                since = stepper.taken
            most = min(2 * most, _MOST)

    def whole(self, first: Array) -> Callable[[], Array | None]:
        """What takes the run from its start to its end at once, as `BlockStepper.whole`."""
        held = self._table(self._times.end)
        if held.until[-1] < self._times.last:
            return lambda: None
        take = self.stepper.whole(self._at.y, first, self._times, held, WINDOW)

        def taken() -> Array | None:
            self._end = held, None
            return take()

        return taken

    def states(self, watch: StallWatch) -> Iterator[State]:
        """The same, a state of all joints at a time."""
        after_q, after_v = self._ends
        for rows in self.rows(watch, is_remembered=True):
            for self._seen, row in enumerate(rows, 1):
                z = row[after_v:]
                q, v = row[1:after_q], row[after_q:after_v]
                yield State(float(row[0]), q, v, z if z.size else NONE)

    @property
    def progress(self) -> Progress:
        """How far the run is after the last block."""
        return self._at if self._end is None else self._progress(*self._end)

    def remembered(self) -> tuple[Progress, int, Memory]:
        """How far the run is at the newest sample that was given, steps until then, memory."""
        stepper = self.stepper
        if self._before is None:
            return self.progress, stepper.taken, stepper.checkpoint()
        memory, held = self._before
        after = stepper.checkpoint()
        stepper.restore(memory, memory["last"])
        block = stepper.samples(self._times, held, 2**62, self._seen)
        found = self._progress(held, block.intervals), stepper.taken, stepper.checkpoint()
        stepper.restore(after, after["last"])
        return found

    def _progress(self, held: HeldTable, interval: int | None) -> Progress:
        """How far the run is, in an interval of held inputs or after the last one."""
        stepper = self.stepper
        if interval is None:
            interval = int(np.searchsorted(held.now, stepper.state.t, side="right")) - 1
        now = held.until[-1] if interval == len(held.now) else held.now[interval]
        return Progress(self._origin, stepper.newest, stepper.state, stepper.is_within, float(now))

    def _step_alone(self, held: HeldTable) -> None:
        """One step by whatever takes it, to the next sample at most if samples within are none."""
        stepper, sample, times = self.stepper, self.stepper.newest, self._times
        end = times.due(sample + 1)
        if stepper.spans_samples and not stepper.ends_at_samples:
            now = float(held.now[0])
            end = step_end(stepper.state, sample, times, now, stepper.is_fixed)
        y = self._alone(stepper.state, held.values[0], min(end, float(held.until[0])))
        stepper.begin_samples(y, sample, is_within=True)

    def _left(self, held: HeldTable, block: SampleBlock, most: int) -> HeldTable:
        """The inputs from where a block ended."""
        rest = HeldTable(*(rows[block.intervals :] for rows in held))
        enough = self._times.due(self.stepper.newest + most)
        if len(rest.until) and (rest.until[-1] >= enough or len(rest.until) > _ROWS // 2):
            return rest
        more = self._table(most)
        both = zip(rest, more, strict=True)
        return HeldTable(*(np.concatenate(pair) for pair in both))

    def _table(self, most: int) -> HeldTable:
        """Inputs from the end of the last table on, as far as so many samples take them."""
        inputs, end = self._inputs, self._times.due(self.stepper.newest + most)
        until: list[float] = []
        values: list[Array] = []
        now: list[float] = []
        while len(until) < _ROWS and (not until or until[-1] < end):
            now.append(inputs.now)
            values.append(self._idle if inputs.u is None else inputs.u)
            until.append(inputs.end)
            if inputs.end == np.inf:
                break
            inputs.reach(inputs.end)
        return HeldTable(np.array(until), np.array(values).reshape(len(until), -1), np.array(now))


class RunTable:
    """A run from a start to its end as rows, taken again where it is asked for again.

    Args:
        x: State of all joints that it was asked for.
        duration: [s].
        begin: Begins the run.

    Attributes:
        blocks: The run as it was begun last.
    """

    def __init__(
        self, x: State, duration: float, first: State, begin: Callable[[], SampleBlocks]
    ) -> None:
        self._x = x
        self._duration = duration
        self._begin = begin
        self._first = np.concatenate(([first.t], *first[1:4]))
        self.blocks = begin()
        self._take = self.blocks.whole(self._first)

    def serves(self, x: State, duration: float) -> bool:
        """Whether it is the run of a start and a duration."""
        return duration == self._duration and (x is self._x or is_same(x, self._x))

    def rows(self, watch: StallWatch) -> Array:
        """The samples, as of `SampleBlock.rows`.

        Args:
            watch: Looks at the pace of the steps.
        """
        rows = self._take()
        if rows is None:
            self.blocks.stepper.restart()
            self.blocks = self._begin()
            rows = np.concatenate((self._first[None], *self.blocks.rows(watch, _MOST)))
        return rows


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
