"""A stepper whose steps are taken in native code."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from mbd_ros.compiled.runs.native_run import NativeRun
from mbd_ros.compiled.runs.run_layout import Status
from mbd_ros.core.state import Array, Memory, State, copied, is_same
from mbd_ros.methods.integration.stepping import BlockStepper, HeldTable, SampleBlock, Stepper

WENT_ON = (Status.DONE, Status.PAUSED, Status.NO_INPUTS)  # a run that no step has stopped


class NativeStepper(BlockStepper):
    """Steps and corrections in native code; a step that it cannot take is one of plain Python.

    Args:
        plain: The same method in Python.
        correct: What stabilization makes of a state after a step of that.
        idle: Inputs where none are given.

    Attributes:
        handed_over: Steps that plain Python has taken.
    """

    def __init__(
        self, run: NativeRun, plain: Stepper, correct: Callable[[State], State], idle: Array
    ) -> None:
        self._run, self._plain, self._correct, self._idle = run, plain, correct, idle
        self.is_fixed, self.handed_over = plain.is_fixed, 0
        self._last: State | None = None
        self._is_plain = self._has_plain = False  # the last step; any since the start

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
        return self._run.steps + self.handed_over

    @property
    def state(self) -> State:
        """The integrated state after the last step."""
        if self._last is None:
            self._last = self._run.state()
        return self._last

    def begin_samples(self, y: State, sample: int, *, is_within: bool) -> None:
        """Say where the samples go on."""
        self.enter(y)
        self._run.begin_samples(sample, is_within=is_within)

    def samples(self, times: Any, inputs: HeldTable, steps: int, most: int) -> SampleBlock:
        """The samples after the newest one."""
        self._last, self._is_plain = None, False
        rows, status = self._run.samples(times, inputs, steps, most)
        return SampleBlock(rows, self._run.interval, status not in WENT_ON)

    def full_run(
        self, y: State, first: Array, times: Any, inputs: HeldTable, steps: int
    ) -> Callable[[], Array | None]:
        """Return a function that takes whole runs in one call."""
        take = self._run.full_run(y, first, times, inputs, steps)

        def compute() -> Array | None:
            self._last, self._is_plain = None, False
            return take()

        return compute

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step; x itself at or after `end`."""
        return self.stride(x, u, end, 1)[0]

    def stride(
        self,
        x: State,
        u: Array | None,
        end: float,
        most: int,
        watch: Callable[[Array], bool] | None = None,
    ) -> tuple[State, int]:
        """Advance by several steps.

        Args:
            x: State to start from.
            u: Inputs, held over the steps.
            end: Time that the steps do not go beyond [s].
            most: Largest number of steps that are taken.
            watch: Not called: native code watches its steps itself.

        Returns:
            The last state, and how many steps were taken.
        """
        if not self.takes_blocks:
            return self._step_plainly(x, u, end), 1
        self.enter(x)
        before = self._run.steps
        status = self._run.advance(self.filled(u), end, most)
        count = self._run.steps - before
        if status in WENT_ON:
            self._is_plain = False
            if not count:
                return x, 0
            self._last = after = self._run.state()
            return after, count
        if count:
            self._last, self._is_plain = self._run.state(), False
            return self._last, count
        return self._step_plainly(x, u, end), 1

    def settle(self, x: State, u: Array | None) -> State:
        """The first state itself; where its rows depend on one another, all steps are plain ones.

        Args:
            x: State from which the first step starts.
            u: Inputs there; None without any.
        """
        health = self._run.health(x, self._idle if u is None else u)
        self.takes_blocks = not health < self._run.least_health
        return x

    def restart(self) -> None:
        """Forget everything that was kept from earlier steps."""
        self._run.restart()
        self._plain.restart()
        self._last, self._has_plain = None, False

    def checkpoint(self) -> Memory:
        """The memory of the native run, beside that of plain steps."""
        run_state = {"run": self._run.checkpoint(), "last": copied(self.state)}
        flags = {"is_plain": self._is_plain, "handed_over": self.handed_over}
        flags["takes_blocks"] = self.takes_blocks
        return {
            **run_state,
            **flags,
            "plain": self._plain.checkpoint() if self._has_plain else None,
        }

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Go on as after the step at which a checkpoint was taken, with the same bits."""
        self._run.restore(checkpoint["run"])
        self._plain.restart()
        self._has_plain = checkpoint["plain"] is not None
        if self._has_plain:
            self._plain.restore(checkpoint["plain"], x)
        self._is_plain, self.handed_over = checkpoint["is_plain"], checkpoint["handed_over"]
        self.takes_blocks = checkpoint["takes_blocks"]
        self._last = x if is_same(checkpoint["last"], x) else checkpoint["last"]

    def again(self, h: float, t: float) -> State:
        """The last step taken again from its start, with the order of the method."""
        if self._is_plain:
            after = self._plain.again(h, t)
            self._run.load(after)
        else:
            after, status = self._run.again(h, t)
            if status != Status.DONE:
                after = after._replace(q=np.full_like(after.q, np.nan))
        self._last = after
        return after

    def continue_from(self, x: State) -> None:
        """Go on from a state that was made of the last one, history kept."""
        self._run.load(x, keeps_history=True)
        self._last = x

    def interpolate(self, t: float) -> State:
        """State inside the last step, corrected."""
        if self._is_plain:
            return self._correct(self._plain.interpolate(t))
        return self._run.interpolate(t)[0]

    def enter(self, x: State) -> None:
        """Let the run stand at a state."""
        if x is not self._last:
            self._run.load(x)
            self._last = x

    def filled(self, u: Array | None) -> Array:
        """Inputs where none are given, too."""
        return self._idle if u is None else u

    def _step_plainly(self, x: State, u: Array | None, end: float) -> State:
        after, self._has_plain = self._plain.step(x, u, end), True
        if after is x:
            return x
        if np.isfinite(after.q).all() and np.isfinite(after.v).all():
            after = self._correct(after)
        self.handed_over += 1
        self._run.load(after)
        self._last, self._is_plain = after, True
        return after
