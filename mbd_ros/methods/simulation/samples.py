"""Samples of a run: their times, the inputs in between, and checkpoints.

Samples are at origin + n dt, the last one exactly at the end. Inputs u are constant from jump to
jump, and steps end at jumps. A `Checkpoint` holds everything on which later samples depend.
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
_ROWS = 65536  # largest number of input intervals of a block
Alone = Callable[[State, Array | None, float], State]


class SampleTimes(NamedTuple):
    """Times of the samples of a run.

    Attributes:
        origin: Time of the first sample [s].
        dt: Interval [s].
        last: Time of the last sample [s].
        end: Number of the last sample; the first is 0.
        resolution: Resolution of floating-point times at the end of the run [s].
        slack: Two times that differ by at most this count as equal [s].
    """

    origin: float
    dt: float
    last: float
    end: int
    resolution: float
    slack: float

    def due(self, sample: int) -> float:
        """Return the time of a sample [s]."""
        return min(self.origin + sample * self.dt, self.last)


def sample_times(origin: float, duration: float, dt: float) -> SampleTimes:
    """Return the sample times of a run from `origin`; the last interval may be shorter."""
    last, end = origin + duration, math.ceil(duration / dt - SAME_TIME)
    resolution = 2.0 * math.ulp(max(abs(origin), abs(last)))
    return SampleTimes(origin, dt, last, end, resolution, max(SAME_TIME * dt, resolution))


def step_end(y: State, sample: int, times: SampleTimes, now: float, is_fixed: bool) -> float:
    """Return the latest end of the step after a sample, so that samples stay at n dt."""
    here = times.origin + sample * times.dt
    late = abs(here - y.t)
    is_rounded = late > 0.2 * times.slack or is_fixed  # a sum of steps, to be put right
    is_off = now > here + times.slack  # back to the samples
    is_next = (is_rounded and late < 1.0e3 * times.slack) or is_off
    return times.due(sample + 1) if is_next else times.last


class HeldInputs:
    """Zero-order hold of the inputs u from jump to jump, where steps must end.

    Args:
        sources: Input sources of u.
        times: Sample times of the run; a jump next to a sample is moved onto it.
        now: Time of the last jump of u, or start of the run [s].

    Attributes:
        u: Inputs from `now` on; None without sources.
        now: Time of the last jump of u, or start of the run [s].
        end: Time of the next jump, where a step must end [s]; inf if there is none.
    """

    def __init__(self, sources: Sources, times: SampleTimes, now: float) -> None:
        self._sources = sources
        self._times = times
        self._jumps = sources.jumps(now, times.last)
        self._next = next(self._jumps, math.inf)
        self.u: Array | None = None
        self._hold(now)

    def advance(self, t: float) -> None:
        """Update the inputs at the end [s] of a step."""
        if t >= self.end:
            self._hold(self.end)

    def _hold(self, now: float) -> None:
        jump = self.now = now
        while self._next <= now + self._times.slack:
            jump = max(jump, self._next)
            self._next = next(self._jumps, math.inf)
        self.u = self._sources.hold(jump)
        self.end = self._on_sample(self._next) if self._next < math.inf else math.inf

    def _on_sample(self, jump: float) -> float:
        origin, dt = self._times.origin, self._times.dt
        sample = origin + round((jump - origin) / dt) * dt
        return sample if abs(sample - jump) <= self._times.slack else jump


class Progress(NamedTuple):
    """Progress of a run.

    Attributes:
        origin: First time of the run [s]; samples are at origin + sample dt.
        sample: Number of the newest sample; the first is 0.
        y: State of the integrated coordinates after the last step.
        is_within: Whether the last step contains samples that have not been returned yet.
        held_since: Time of the last jump of the inputs [s].
    """

    origin: float
    sample: int
    y: State
    is_within: bool
    held_since: float


class Checkpoint(NamedTuple):
    """State of a simulation at a sample.

    A simulation of the same scene, method and dt continues from it with bit-identical results. It
    holds only numbers and arrays, and can be pickled.

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
        self._yielded = 0
        self._at = at
        self._end: tuple[HeldTable, int | None] | None = None

    def rows(
        self, watch: StallWatch, most: int = _FIRST, *, keeps_checkpoint: bool = False
    ) -> Iterator[Array]:
        """Yield blocks of samples in the layout of `SampleBlock.rows`.

        Args:
            watch: Watches the pace of the steps.
            most: Number of samples of the first block.
            keeps_checkpoint: Whether `checkpoint` may be called between samples.
        """
        stepper, times, most = self.stepper, self._times, min(most, _MOST)
        watch.begin(self._at.y.t)
        check_at, since = WINDOW, stepper.steps_taken
        table = self._table(most)
        while stepper.newest < times.end:
            if keeps_checkpoint:
                self._before = stepper.checkpoint(), table
                self._yielded = 0
            block = stepper.samples(times, table, check_at - (stepper.steps_taken - since), most)
            if len(block.rows):
                yield block.rows
            self._end = table, block.intervals
            if stepper.newest == times.end:
                break
            table = self._remaining_inputs(table, block, most)
            if block.is_stuck:
                self._step_alone(table)
            if stepper.steps_taken - since >= check_at:
                watch.check(stepper.state, table.values[0], times.last)
                since = stepper.steps_taken
            most = min(2 * most, _MOST)

    def full_run(self, first: Array) -> Callable[[], Array | None]:
        """Return a function that computes the full run at once, see `BlockStepper.full_run`."""
        table = self._table(self._times.end)
        if table.until[-1] < self._times.last:
            return lambda: None
        take = self.stepper.full_run(self._at.y, first, self._times, table, WINDOW)

        def compute() -> Array | None:
            self._end = table, None
            return take()

        return compute

    def states(self, watch: StallWatch) -> Iterator[State]:
        """Yield the samples one by one as states of all joints."""
        after_q, after_v = self._ends
        for rows in self.rows(watch, keeps_checkpoint=True):
            for self._yielded, row in enumerate(rows, 1):
                z = row[after_v:]
                q, v = row[1:after_q], row[after_q:after_v]
                yield State(float(row[0]), q, v, z if z.size else NONE)

    @property
    def progress(self) -> Progress:
        """Progress of the run after the last block."""
        return self._at if self._end is None else self._progress(*self._end)

    def checkpoint(self) -> tuple[Progress, int, Memory]:
        """Return progress, number of steps and stepper memory at the newest yielded sample."""
        stepper = self.stepper
        if self._before is None:
            return self.progress, stepper.steps_taken, stepper.checkpoint()
        memory, table = self._before
        after = stepper.checkpoint()
        stepper.restore(memory, memory["last"])
        block = stepper.samples(self._times, table, 2**62, self._yielded)
        checkpoint = (
            self._progress(table, block.intervals),
            stepper.steps_taken,
            stepper.checkpoint(),
        )
        stepper.restore(after, after["last"])
        return checkpoint

    def _progress(self, table: HeldTable, interval: int | None) -> Progress:
        """Return the progress in an interval of constant inputs, None for the last one."""
        stepper = self.stepper
        if interval is None:
            interval = int(np.searchsorted(table.now, stepper.state.t, side="right")) - 1
        now = table.until[-1] if interval == len(table.now) else table.now[interval]
        return Progress(self._origin, stepper.newest, stepper.state, stepper.is_within, float(now))

    def _step_alone(self, table: HeldTable) -> None:
        """Take one step outside blocks, to the next sample at most if it cannot span samples."""
        stepper, sample, times = self.stepper, self.stepper.newest, self._times
        end = times.due(sample + 1)
        if stepper.spans_samples and not stepper.ends_at_samples:
            now = float(table.now[0])
            end = step_end(stepper.state, sample, times, now, stepper.is_fixed)
        y = self._alone(stepper.state, table.values[0], min(end, float(table.until[0])))
        stepper.begin_samples(y, sample, is_within=True)

    def _remaining_inputs(self, table: HeldTable, block: SampleBlock, most: int) -> HeldTable:
        """Return the inputs from the end of a block on."""
        remaining = HeldTable(*(rows[block.intervals :] for rows in table))
        enough = self._times.due(self.stepper.newest + most)
        until = remaining.until
        if len(until) and (until[-1] >= enough or len(until) > _ROWS // 2):
            return remaining
        both = zip(remaining, self._table(most), strict=True)
        return HeldTable(*(np.concatenate(pair) for pair in both))

    def _table(self, most: int) -> HeldTable:
        """Return the inputs from the end of the last table on, for at most so many samples."""
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
            inputs.advance(inputs.end)
        return HeldTable(np.array(until), np.array(values).reshape(len(until), -1), np.array(now))


class RunTable:
    """A full run as rows, which can be computed again with the same setup.

    Args:
        x: Initial state of all joints, before its projection.
        duration: Duration of the run [s].
        first: Projected initial state of all joints.
        begin: Function that begins the run.

    Attributes:
        blocks: The newest run.
    """

    def __init__(
        self, x: State, duration: float, first: State, begin: Callable[[], SampleBlocks]
    ) -> None:
        self._x = x
        self._duration = duration
        self._begin = begin
        self._first = np.concatenate(([first.t], *first[1:4]))
        self.blocks = begin()
        self._take = self.blocks.full_run(self._first)

    def matches(self, x: State, duration: float) -> bool:
        """Return whether this is the run with an initial state and a duration."""
        return duration == self._duration and (x is self._x or is_same(x, self._x))

    def rows(self, watch: StallWatch) -> Array:
        """Compute all samples in the layout of `SampleBlock.rows`.

        Args:
            watch: Watches the pace of the steps.
        """
        rows = self._take()
        if rows is None:
            self.blocks.stepper.restart()
            self.blocks = self._begin()
            rows = np.concatenate((self._first[None], *self.blocks.rows(watch, _MOST)))
        return rows


def check_origin(checkpoint: Checkpoint, made_by: tuple[str, float, int, int, int]) -> None:
    """Check that a checkpoint belongs to a simulation.

    Raises:
        ModelError: Its method, dt or number of states differs.
    """
    if checkpoint.made_by != made_by:
        texts = (_describe(*made) for made in (checkpoint.made_by, made_by))
        raise ModelError("a checkpoint of {} cannot be continued by {}".format(*texts))


def _describe(method: str, dt: float, nq: int, nv: int, nz: int) -> str:
    """Describe the simulation of a checkpoint by the entries of `Checkpoint.made_by`."""
    states = f", {nv} velocities and {nz} internal states" if nz else f" and {nv} velocities"
    return f"{method} with dt {dt:g} s, {nq} positions{states}"
