"""Native steps between events, which plain Python locates.

Native code looks at the mode of unilateral rows after every step. It stops behind the step in
which the mode may have ended, and that step is searched with native steps of other lengths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.runs.native_run import NativeRun
from mbd_ros.compiled.runs.native_stepper import WENT_ON, NativeStepper
from mbd_ros.compiled.runs.run_layout import Status
from mbd_ros.core.state import Array, Memory, Mode, State, copied, is_same
from mbd_ros.methods.events.event_steps import EventSteps
from mbd_ros.methods.events.mode_field import ModeField
from mbd_ros.methods.integration.stepping import BlockStepper, HeldTable, SampleBlock, Stepper


class EventStepper(EventSteps, BlockStepper):
    """Steps from event to event, many at a time while the mode goes on.

    Args:
        field: The system in its modes.
        inner: Native steps of that system.
        dt: Step of a fixed-step method, and interval of the output [s].
    """

    spans_samples = True

    def __init__(self, field: ModeField, inner: ModeStepper, dt: float) -> None:
        super().__init__(field, inner, dt)
        self._native, self._run = inner, inner.run
        self._run.ends_at_samples = self.ends_at_samples
        self._has_clearance = False  # native code looks after every step
        self._is_behind = False  # the native state is behind a step that is to be searched
        self._is_new = False  # the native state is newer than the last one known here
        self.can_stride = True

    @property
    def evaluations(self) -> int:
        """How often compiled accelerations were computed."""
        return self._run.evaluations

    @property
    def newest(self) -> int:
        """Number of the newest sample."""
        return self._run.sample

    @property
    def is_within(self) -> bool:
        """Whether the last step has samples inside that are still to come."""
        return self._run.is_within

    @property
    def steps_taken(self) -> int:
        """Steps taken since it was made."""
        return self._run.steps + self._native.handed_over

    @property
    def handed_over(self) -> int:  # type: ignore[override]
        """Steps that plain Python has taken."""
        return self._native.handed_over

    @property
    def plain_steps(self) -> int:
        """Number of plain steps; the others were native ones that Python has searched."""
        return self._native.integrated_plainly

    @property
    def state(self) -> State:
        """Return the integrated state before a step that is to be searched."""
        if self._is_new:
            self._is_new = False
            if self._is_behind:
                self._last = self._run.began()._replace(mode=self.mode)
            else:
                self._last = self._native.newest_state()
        assert self._last is not None
        return self._last

    def begin_samples(self, y: State, sample: int, *, is_within: bool) -> None:
        """Say where the samples go on."""
        if self._last is None:
            self._last = y
        self._native.enter(y)
        self._run.begin_samples(sample, is_within=is_within)

    def samples(self, times: Any, inputs: HeldTable, steps: int, most: int) -> SampleBlock:
        """The samples after the newest one."""
        if self.is_within:
            before = self._within_plain_step(times, most)
            if len(before) == most:
                return SampleBlock(before, 0, False)
            rows, _ = self._run.samples(times, inputs, 0, most - len(before))
            return SampleBlock(np.concatenate((before, rows)), self._run.interval, False)
        if not self._is_ready(self.state, inputs.values[0]):
            return SampleBlock(np.zeros((0, self._run.row)), 0, True)
        if self.field.active(self.mode) or self.field.drives(self.mode):
            # inputs that jump decide the mode again
            inputs = HeldTable(*(column[:1] for column in inputs))
        self._native.enter(self.state)
        rows, status = self._run.samples(times, inputs, steps, most)
        self._came_back(status)
        last = min(self._run.interval, len(inputs.values) - 1)
        self._u = inputs.values[last].copy()
        return SampleBlock(rows, self._run.interval, status not in WENT_ON)

    def _within_plain_step(self, times: Any, most: int) -> Array:
        """Samples inside the last step where that was a plain one, as rows."""
        rows: list[Array] = []
        run, end = self._run, self._run.t - times.slack
        while self._native.is_plain and run.sample < times.end and len(rows) < most:
            due = times.due(run.sample + 1)
            if not due < end:
                break
            x = self.system.expand(self.interpolate(due))
            rows.append(np.concatenate(([due], *x[1:4])))
            run.begin_samples(run.sample + 1, is_within=True)
        return np.array(rows).reshape(-1, run.row)

    def full_run(
        self, y: State, first: Array, times: Any, inputs: HeldTable, steps: int
    ) -> Callable[[], Array | None]:
        """Nothing: events are located by Python."""
        return lambda: None

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step, corrected, or to the next event."""
        x = self._known(x)
        if self._is_behind:
            self._is_behind = False
            self._native.handed_over += 1
            after = self._search(x, u, end, self._native.newest_state())
        else:
            after = super().step(x, u, end)
        if after is x or not np.isfinite(after.v).all():
            return after
        corrected = self._native.correct(after)
        if corrected is not after:
            super().continue_from(corrected)
        return corrected

    def stride(
        self,
        x: State,
        u: Array | None,
        end: float,
        most: int,
        watch: Callable[[Array], bool] | None = None,
    ) -> tuple[State, int]:
        """Advance by several steps at once, as far as the mode goes on."""
        x = self._known(x)
        if self._is_behind or not x.t < end or not self._is_ready(x, u):
            return self.step(x, u, end), 1
        self._native.enter(self.state)
        before = self._run.steps
        status = self._run.advance(self._native.filled(u), end, most)
        count = self._run.steps - before
        self._came_back(status)
        return (self.state, count) if count else (self.step(self.state, u, end), 1)

    def restart(self) -> None:
        """Forget mode, events and earlier steps."""
        super().restart()
        self._is_behind = self._is_new = False

    def continue_from(self, x: State) -> None:
        """Continue in the same mode from a corrected state."""
        self._is_behind = self._is_new = False
        super().continue_from(x)

    def interpolate(self, t: float) -> State:
        """State at a time inside the last step, corrected."""
        return self._native.correct(super().interpolate(t))

    def checkpoint(self) -> Memory:
        """Beside that of `EventSteps` whether the last step is to be searched."""
        last = copied(self.state)
        return {**super().checkpoint(), "last": last, "is_behind": self._is_behind}

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Go on as after the step at which a checkpoint was taken, with the same bits."""
        super().restore(checkpoint, x)
        self._is_behind, self._is_new = checkpoint["is_behind"], False

    def _is_ready(self, x: State, u: Array | None) -> bool:
        """Whether native code goes on from the state after the last step."""
        if self._is_behind:
            return False
        self._last = self._settle(x, u)
        transitions, left = self._transitions, self._run.left
        left[:] = 0.0
        left[[*transitions.left]] = 1.0
        return self._native.is_compiled and not transitions.rests

    def _came_back(self, status: Status) -> None:
        self._is_behind, self._is_new = status is Status.GUARD, True
        self._transitions.left = frozenset(np.flatnonzero(self._run.left).tolist())

    def _known(self, x: State) -> State:
        """The state itself where it is that of the last step."""
        last = self.state if self._last is not None or self._is_new else None
        return last if last is not None and is_same(last, x) else x


class ModeStepper(NativeStepper):
    """Steps of which nothing is corrected; a mode that is not compiled has plain ones.

    Args:
        plain: The same method in Python.
        correct: What stabilization makes of a state after a step.
        idle: Inputs where none are given.
        keys: Numbers of margins, by `Traced.keys`.
        gaps: Rows of the mode that are gaps.

    Attributes:
        mode: What it follows.
        is_compiled: Whether that is compiled.
        integrated_plainly: How many steps plain Python has integrated.
    """

    def __init__(
        self,
        run: NativeRun,
        plain: Stepper,
        correct: Callable[[State], State],
        idle: Array,
        keys: Mapping[tuple[int, int], int],
        gaps: Sequence[int],
    ) -> None:
        super().__init__(run, plain, correct, idle)
        self._is_gap = np.zeros(run.sizes.modes, dtype=np.bool_)
        self._is_gap[gaps] = True
        self.run, self.correct, self._keys = run, correct, keys
        self.mode: Mode = ()
        self.is_compiled, self.integrated_plainly = False, 0

    @property
    def is_plain(self) -> bool:
        """Whether plain Python has taken the last step."""
        return self._is_plain

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations from the next step on."""
        self._plain.follow(accelerate, mode)
        self.mode, self.is_compiled = mode, bool(mode)
        if self.is_compiled:
            self.run.switch(mode)
        self._last = None

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step."""
        pace = self.run.pace
        if self.is_compiled:
            self.enter(x)
            before = self.run.steps
            status = self.run.step_alone(self.filled(u), end)
            if status == Status.DONE:
                if self.run.steps == before:
                    return x
                self._is_plain = False
                return self.newest_state()
            self.run.load(x)
        if not self.is_fixed:
            self._plain.pace = pace
        after, self._has_plain = self._plain.step(x, u, end), True
        if not self.is_fixed:
            self.run.pace = self._plain.pace
        if after is not x:
            self._is_plain, self._last = True, None
            self.handed_over += 1
            self.integrated_plainly += 1
        return after

    def newest_state(self) -> State:
        """Return the integrated state after the last native step, in its mode."""
        self._last = after = self.run.state()._replace(mode=self.mode)
        self._is_plain = False  # the event stepper runs native steps by itself, too
        return after

    def again(self, h: float, t: float) -> State:
        """The last step taken again from its start, with the order of the method."""
        if self._is_plain:
            return self._plain.again(h, t)
        after, status = self.run.again(h, t)
        if status != Status.DONE:
            return self._again_plainly(h, t)
        self._last = after = after._replace(mode=self.mode)
        return after

    def _again_plainly(self, h: float, t: float) -> State:
        """The same where native code has no accelerations, from there on in plain steps."""
        x = self.run.began()._replace(mode=self.mode)
        self._plain.step(x, self.run.inputs, x.t + h)
        self._is_plain = self._has_plain = True
        return self._plain.again(h, t)

    def interpolate(self, t: float) -> State:
        """State inside the last step, uncorrected."""
        if self._is_plain:
            return self._plain.interpolate(t)
        return self.run.inside(t)._replace(mode=self.mode)

    def margin_within(self, which: tuple[int, int]) -> Callable[[float], float] | None:
        """Return a margin within a step that native code has taken."""
        number = self._keys.get(which)
        if self._is_plain or number is None:
            return None
        return lambda t: self.run.margin_within(t, number)

    def margin_again(self, which: tuple[int, int]) -> Callable[[float, float], float] | None:
        """Return a margin again, for a step that native code has taken."""
        number = self._keys.get(which)
        if self._is_plain or number is None:
            return None
        self._last = None  # the run stands behind steps of other lengths from here on
        return lambda h, t: self.run.margin_again(h, t, number)

    def first_event(self, left: Collection[int]) -> tuple[float, int] | None:
        """Return the first event of a step that native code has taken."""
        if self._is_plain or not self.run.sizes.contacts:
            return None
        h, row = self.run.first_event(self._is_gap, left)
        if not math.isinf(h):
            self._last = None  # as `margin_again`
        return None if math.isnan(h) else (h, row)

    def continue_from(self, x: State) -> None:
        """Go on from a state that stabilization has made of the last one, history kept."""
        if self._is_plain:
            self._plain.continue_from(x)
        else:
            super().continue_from(x)
