"""Native steps in a mode of rows that give way, as event location takes them."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.runs.native_run import NativeRun
from mbd_ros.compiled.runs.native_stepper import NativeStepper
from mbd_ros.compiled.runs.native_types import Status
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.state import Array, Mode, State


class ModeStepper(NativeStepper):
    """Steps of which nothing is corrected; a mode that is not compiled has plain ones.

    Args:
        run: The integration.
        plain: The same method in Python.
        correct: What stabilization makes of a state after a step.
        idle: Inputs where none are given.
        keys: Numbers of margins, by `Traced.keys`.
        gaps: Rows of the mode that are gaps.

    Attributes:
        run: As given.
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
        """As `Stepper.follow`."""
        self._plain.follow(accelerate, mode)
        self.mode, self.is_compiled = mode, bool(mode)
        if self.is_compiled:
            self.run.switch(mode)
        self._last = None

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """As `Stepper.step`."""
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
        """What is integrated after the last native step, in its mode."""
        self._last = after = self.run.state()._replace(mode=self.mode)
        self._is_plain = False  # the event stepper runs native steps by itself, too
        return after

    def again(self, h: float, t: float) -> State:
        """As `Stepper.again`."""
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
        """As `Stepper.margin_within`, where native code has taken the step."""
        number = self._keys.get(which)
        if self._is_plain or number is None:
            return None
        return lambda t: self.run.margin_within(t, number)

    def margin_again(self, which: tuple[int, int]) -> Callable[[float, float], float] | None:
        """As `Stepper.margin_again`, where native code has taken the step."""
        number = self._keys.get(which)
        if self._is_plain or number is None:
            return None
        self._last = None  # the run stands behind steps of other lengths from here on
        return lambda h, t: self.run.margin_again(h, t, number)

    def first_event(self, left: Collection[int]) -> tuple[float, int] | None:
        """As `Stepper.first_event`, where native code has taken the step."""
        if self._is_plain or not self.run.sizes.contacts:
            return None
        h, row = self.run.first_event(self._is_gap, left)
        if not math.isinf(h):
            self._last = None  # as `margin_again`
        return None if math.isnan(h) else (h, row)

    def continue_from(self, x: State) -> None:
        """As `Stepper.continue_from`."""
        if self._is_plain:
            self._plain.continue_from(x)
        else:
            super().continue_from(x)
