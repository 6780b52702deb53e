"""A simulation: a system, an integrator and a stabilization at work.

`run` and `sampled` predict a motion from its start to its end, in samples; `advance` steps to a
given time. A run can be resumed from a `Checkpoint`, with the same bits.
"""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.stepping import BlockStepper, Integrator
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.methods.simulation.checked_steps import CheckedSteps
from mbd_ros.methods.simulation.samples import (
    Checkpoint,
    HeldInputs,
    Progress,
    RunTable,
    SampleBlocks,
    refuse_other,
    sample_times,
    step_end,
)
from mbd_ros.methods.simulation.stall import PATIENCE, WINDOW, Notice, StallWatch, refuse_crawl

_STRIDE = 16  # steps after which a state must be finite


class Simulation(CheckedSteps):
    """Predicts motion from forces and commands.

    Args:
        system: The system; its rows are corrected as the stabilization demands.
        stabilization: What keeps the rows; idle where the integrator keeps them itself.
        dt: Step of a fixed-step method, and interval of the output [s], > 0.

    Attributes:
        how: What code takes the steps, for people; empty where nobody asked for other code.
    """

    def __init__(
        self, system: System, integrator: Integrator, stabilization: Stabilization, dt: float
    ) -> None:
        super().__init__(system, integrator, stabilization, dt)
        self.how = ""
        self._progress: Progress | None = None
        self._blocks: SampleBlocks | None = None
        self._table: RunTable | None = None

    def start(self, x: State, u: Array | None = None) -> State:
        """The nearest consistent state of the integrated coordinates to a state of all joints.

        Args:
            u: Inputs there, which may decide in which mode it goes on.

        Raises:
            SolveError: The mechanism cannot be assembled near it, its mass matrix is singular, or
                internal states have no equilibrium there; or bodies of contacts overlap.
            ModelError: An internal state starts outside its bounds.
        """
        self.stepper.restart()
        self._blocks = None
        y = self._assembled(x)
        if self.overshoots is not None:
            self.overshoots.begin(y)
        if self._nz:
            from mbd_ros.core.dynamics.internal_dynamics import settled

            y = settled(self.system, y, u)
        y = self.stepper.settle(y, u)
        self._progress = Progress(y.t, 0, y, False, y.t)
        return y

    def run(
        self,
        x: State | Checkpoint,
        duration: float,
        notice: Notice | None = None,
    ) -> Iterator[State]:
        """States of all joints every dt, the first one included; steps end where inputs jump.

        Args:
            x: State of all joints; moved onto the constraints first. Or a checkpoint of a run: the
                samples after it follow.
            duration: [s], >= 0, from the first time of the run on; a last shorter interval ends
                exactly there.
            notice: Is called once where steps are so short that the end is far away.

        Raises:
            DivergedError: The state is no longer finite, or steps are too short to get to the end.
            SolveError: The mechanism cannot be assembled, or equations contradict one another.
            ModelError: The checkpoint is one of another scene, method or dt.
        """
        if isinstance(x, Checkpoint):
            self.resume(x)
        else:
            u = self.system.loads.sources.held(x.t)
            yield self.system.expand(self.start(x, u))
        yield from self._samples(self._progressed(), duration, notice)

    def _samples(self, at: Progress, duration: float, notice: Notice | None) -> Iterator[State]:
        """States of all joints at the samples after the newest one."""
        times, (origin, k, y, is_within, now) = sample_times(at.origin, duration, self.dt), at
        stepper = self.stepper
        if isinstance(stepper, BlockStepper) and stepper.takes_blocks:
            self._blocks = SampleBlocks(stepper, self.system, times, at, self._step)
            for x in self._blocks.states(StallWatch(self.system, self.dt, notice)):
                self.steps = stepper.taken
                yield x
            self._progress, self._blocks = self._blocks.progress, None
            return
        watch, look_at = StallWatch(self.system, self.dt, notice), self.steps + WINDOW
        watch.begin(y.t)
        inputs = HeldInputs(self.system.loads.sources, times, now)
        while k < times.end:
            due = times.due(k + 1)
            if not is_within:
                end = times.due(k + 1)
                if not self.stepper.ends_at_samples:
                    end = step_end(y, k, times, inputs.now, self.stepper.is_fixed)
                y = self._step(y, inputs.u, min(end, inputs.end))
                if self.steps >= look_at:
                    watch.look(y, inputs.u, times.last)
                    look_at = self.steps + WINDOW
                if 0.0 < abs(y.t - due) <= times.resolution == times.slack:  # times are coarse
                    y = y._replace(t=due)
                    self.stepper.continue_from(y)
            while k < times.end and due < y.t - times.slack:
                x, k = self.system.expand(self._corrected(self.stepper.interpolate(due))), k + 1
                self._progress = Progress(origin, k, y, True, inputs.now)
                yield x
                due = times.due(k + 1)
            is_within, y_next, y = False, y, self._corrected(y)
            if y is not y_next:
                self.stepper.continue_from(y)
            inputs.reach(y.t)
            if k < times.end and due <= y.t + times.slack:
                k += 1
                self._progress = Progress(origin, k, y, False, inputs.now)
                yield self.system.expand(y)

    def sampled(self, x: State, duration: float) -> Array:
        """The states of `run` as rows: time, positions, velocities, internal states.

        Args:
            x: As for `run`.
            duration: As for `run`.

        Returns:
            Shape (samples, 1 + nq + nv + nz), of all joints.

        Raises:
            DivergedError: As `run`.
        """
        stepper = self.stepper
        if self._table is None or not self._table.serves(x, duration):
            first = self.start(x, self.system.loads.sources.held(x.t))
            if not (isinstance(stepper, BlockStepper) and stepper.takes_blocks):
                return np.array([np.concatenate(([s.t], *s[1:4])) for s in self.run(x, duration)])
            times, at = sample_times(first.t, duration, self.dt), self._progressed()
            begin = partial(SampleBlocks, stepper, self.system, times, at, self._step)
            self._table = RunTable(x, duration, self.system.expand(first), begin)
        rows = self._table.rows(StallWatch(self.system, self.dt))
        self._blocks = self._table.blocks
        self.steps = self._blocks.stepper.taken
        return rows

    def checkpoint(self) -> Checkpoint:
        """All that the samples after the newest one depend on, beside the scene and its inputs.

        Raises:
            ModelError: Nothing was started yet.
        """
        stops = {} if self.overshoots is None else self.overshoots.checkpoint()
        if self._blocks is not None:
            progress, steps, memory = self._blocks.remembered()
        else:
            progress, steps, memory = self._progressed(), self.steps, self.stepper.checkpoint()
        return Checkpoint(self._made_by, progress, steps, self.worst, stops, memory)

    def resume(self, checkpoint: Checkpoint) -> State:
        """Go back to a checkpoint; returns the state of the integrated coordinates there.

        Raises:
            ModelError: It is one of another scene, method or dt.
        """
        refuse_other(checkpoint, self._made_by)
        self._progress, self.steps, self.worst = checkpoint[1:4]
        y, self._blocks = checkpoint.progress.y, None
        self.stepper.restart()
        self.stepper.restore(checkpoint.memory, y)
        if self.overshoots is not None:
            self.overshoots.restore(checkpoint.stops, y)
        return y

    def advance(self, y: State, u: Array | None, due: float) -> State:
        """State of the integrated coordinates at a time, in as many steps as the method needs.

        Args:
            y: What `start` or the last `advance` returned.
            u: Commands, held until then.
            due: [s]; y itself at or after it.

        Raises:
            DivergedError: The state is no longer finite.
            SolveError: Equations contradict one another.
        """
        is_looked_at = self._is_corrected or self.overshoots is not None
        nearly = due - max(SAME_TIME * self.dt, 2.0 * math.ulp(due))
        begin, first, look_at = y.t, self.steps, self.steps + PATIENCE * WINDOW
        while y.t < nearly:
            if self.steps >= look_at:
                refuse_crawl(self.system, y, u, (y.t - begin) / (self.steps - first), self.dt, due)
                look_at = self.steps + WINDOW
            y_next = self._step(y, u, due, 1 if is_looked_at else _STRIDE)
            y = self._corrected(y_next)
            if y is not y_next:
                self.stepper.continue_from(y)
        self._progress = self._progressed()._replace(y=y)
        return y

    def _progressed(self) -> Progress:
        if self._blocks is not None:
            self._progress, self._blocks = self._blocks.progress, None
        if self._progress is None:
            raise ModelError("a simulation that has not started has no checkpoint")
        return self._progress
