"""Simulation of a system with an integrator and a stabilization of constraint drift.

`run` and `sampled` predict a whole motion in samples; `advance` steps to a time. A run can be
resumed from a `Checkpoint` with bit-identical results.
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
    check_origin,
    sample_times,
    step_end,
)
from mbd_ros.methods.simulation.stall import PATIENCE, WINDOW, Notice, StallWatch, check_pace

_STRIDE = 16  # steps between two checks that the state is finite


class Simulation(CheckedSteps):
    """Simulation of a mechanism: predicts its motion from forces and commands.

    Args:
        system: The equations of motion.
        integrator: The integration method.
        stabilization: Correction of constraint drift; unused if the integrator satisfies the
            constraints itself.
        dt: Step of a fixed-step method, and interval of the output [s], > 0.

    Attributes:
        how: Description of compiled code that takes the steps; empty if there is none.
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
        """Start at the nearest consistent state and return it in the integrated coordinates.

        Args:
            x: State of all joints.
            u: Inputs at the start, which can affect the initial mode of contacts.

        Raises:
            SolveError: The mechanism cannot be assembled near x, its mass matrix is singular,
                internal states have no equilibrium, or bodies of contacts overlap.
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
        """Yield the states of all joints every dt, including the first one.

        Steps end where inputs jump.

        Args:
            x: Initial state of all joints, which is projected onto the constraints; or a
                checkpoint of a run, whose remaining samples follow.
            duration: Duration from the first time of the run [s], >= 0. The last interval can be
                shorter than dt, so that the run ends exactly there.
            notice: Function that is called once if steps are so short that the end is far away.

        Raises:
            DivergedError: The state is no longer finite, or steps are too short to reach the end.
            SolveError: The mechanism cannot be assembled, or an equation has no solution.
            ModelError: The checkpoint belongs to another scene, method or dt.
        """
        if isinstance(x, Checkpoint):
            self.resume(x)
        else:
            u = self.system.loads.sources.hold(x.t)
            yield self.system.expand(self.start(x, u))
        yield from self._samples(self._progressed(), duration, notice)

    def _samples(self, at: Progress, duration: float, notice: Notice | None) -> Iterator[State]:
        """Yield the states of all joints at the samples after the newest one."""
        times, (origin, k, y, is_within, now) = sample_times(at.origin, duration, self.dt), at
        stepper = self.stepper
        if isinstance(stepper, BlockStepper) and stepper.takes_blocks:
            self._blocks = SampleBlocks(stepper, self.system, times, at, self._step)
            for x in self._blocks.states(StallWatch(self.system, self.dt, notice)):
                self.steps = stepper.steps_taken
                yield x
            self._progress, self._blocks = self._blocks.progress, None
            return
        watch, check_at = StallWatch(self.system, self.dt, notice), self.steps + WINDOW
        watch.begin(y.t)
        inputs = HeldInputs(self.system.loads.sources, times, now)
        while k < times.end:
            due = times.due(k + 1)
            if not is_within:
                end = times.due(k + 1)
                if not self.stepper.ends_at_samples:
                    end = step_end(y, k, times, inputs.now, self.stepper.is_fixed)
                y = self._step(y, inputs.u, min(end, inputs.end))
                if self.steps >= check_at:
                    watch.check(y, inputs.u, times.last)
                    check_at = self.steps + WINDOW
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
            inputs.advance(y.t)
            if k < times.end and due <= y.t + times.slack:
                k += 1
                self._progress = Progress(origin, k, y, False, inputs.now)
                yield self.system.expand(y)

    def sampled(self, x: State, duration: float) -> Array:
        """Return the states of `run` as rows: time, positions, velocities, internal states.

        Args:
            x: Initial state of all joints.
            duration: Duration of the run [s].

        Returns:
            States of all joints, shape (samples, 1 + nq + nv + nz).

        Raises:
            DivergedError: The state is no longer finite, or steps are too short to reach the end.
        """
        stepper = self.stepper
        if self._table is None or not self._table.matches(x, duration):
            first = self.start(x, self.system.loads.sources.hold(x.t))
            if not (isinstance(stepper, BlockStepper) and stepper.takes_blocks):
                return np.array([np.concatenate(([s.t], *s[1:4])) for s in self.run(x, duration)])
            times, at = sample_times(first.t, duration, self.dt), self._progressed()
            begin = partial(SampleBlocks, stepper, self.system, times, at, self._step)
            self._table = RunTable(x, duration, self.system.expand(first), begin)
        rows = self._table.rows(StallWatch(self.system, self.dt))
        self._blocks = self._table.blocks
        self.steps = self._blocks.stepper.steps_taken
        return rows

    def checkpoint(self) -> Checkpoint:
        """Return everything on which later samples depend, apart from the scene and its inputs.

        Raises:
            ModelError: The simulation has not started.
        """
        stops = {} if self.overshoots is None else self.overshoots.checkpoint()
        if self._blocks is not None:
            progress, steps, memory = self._blocks.checkpoint()
        else:
            progress, steps, memory = self._progressed(), self.steps, self.stepper.checkpoint()
        return Checkpoint(self._made_by, progress, steps, self.worst, stops, memory)

    def resume(self, checkpoint: Checkpoint) -> State:
        """Return to a checkpoint.

        Returns:
            State of the integrated coordinates at the checkpoint.

        Raises:
            ModelError: The checkpoint belongs to another scene, method or dt.
        """
        check_origin(checkpoint, self._made_by)
        self._progress, self.steps, self.worst = checkpoint[1:4]
        y, self._blocks = checkpoint.progress.y, None
        self.stepper.restart()
        self.stepper.restore(checkpoint.memory, y)
        if self.overshoots is not None:
            self.overshoots.restore(checkpoint.stops, y)
        return y

    def advance(self, y: State, u: Array | None, due: float) -> State:
        """Advance to a time, in as many steps as the method needs.

        Args:
            y: Result of `start` or of the last `advance`.
            u: Commands, constant until then.
            due: Time to reach [s]; if y is not before it, y is returned.

        Returns:
            State of the integrated coordinates.

        Raises:
            DivergedError: The state is no longer finite.
            SolveError: An equation has no solution.
        """
        checks_steps = self._is_corrected or self.overshoots is not None
        nearly = due - max(SAME_TIME * self.dt, 2.0 * math.ulp(due))
        begin, first, check_at = y.t, self.steps, self.steps + PATIENCE * WINDOW
        while y.t < nearly:
            if self.steps >= check_at:
                check_pace(self.system, y, u, (y.t - begin) / (self.steps - first), self.dt, due)
                check_at = self.steps + WINDOW
            y_next = self._step(y, u, due, 1 if checks_steps else _STRIDE)
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
