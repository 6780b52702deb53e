"""Samples that a stepper takes many at a time, and the inputs that it needs for that."""

from collections.abc import Callable
from typing import Any, NamedTuple

from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.state import Array, State


class HeldTable(NamedTuple):
    """Inputs that are held from jump to jump.

    Attributes:
        until: Time at which each row ends, where a step ends too [s], shape (m,).
        values: The whole u of each, shape (m, nu).
        now: Time at which each row began [s], shape (m,).
    """

    until: Array
    values: Array
    now: Array


class SampleBlock(NamedTuple):
    """What one call took.

    Attributes:
        rows: A sample a row: time, positions and velocities of all joints, internal states.
        intervals: Rows of the held inputs that lie behind.
        is_stuck: Whether the next step has to be taken alone, by `Stepper.step`.
    """

    rows: Array
    intervals: int
    is_stuck: bool


class BlockStepper(Stepper):
    """A stepper that takes many samples at a time, corrections after steps included.

    Attributes:
        handed_over: Steps that were taken otherwise, since it could not.
        takes_blocks: Whether it does so in this run, or steps have to be taken one by one.
        spans_samples: Whether samples follow that are inside a step which was taken alone.
    """

    handed_over: int = 0
    takes_blocks: bool = True
    spans_samples: bool = False

    @property
    def plain_steps(self) -> int:
        """Those of the steps in `handed_over` that other code has integrated, too."""
        return self.handed_over

    @property
    def evaluations(self) -> int:
        """How often accelerations were computed, those of the system apart."""
        raise NotImplementedError

    def stride(self, x: State, u: Array | None, end: float, most: int) -> tuple[State, int]:
        """Advance by several steps, as `Stepper.step`.

        Returns:
            The last state, and how many steps of at most `most` were taken.
        """
        raise NotImplementedError

    @property
    def newest(self) -> int:
        """Number of the newest sample."""
        raise NotImplementedError

    @property
    def is_within(self) -> bool:
        """Whether the last step has samples inside that are still to come."""
        raise NotImplementedError

    @property
    def taken(self) -> int:
        """Steps taken since it was made."""
        raise NotImplementedError

    @property
    def state(self) -> State:
        """What is integrated, after the last step."""
        raise NotImplementedError

    def begin_samples(self, y: State, sample: int, *, is_within: bool) -> None:
        """Say where the samples go on.

        Args:
            y: What is integrated, after the last step.
            sample: Number of the newest sample.
            is_within: Whether the last step has samples inside that are still to come.
        """
        raise NotImplementedError

    def samples(self, times: Any, held: HeldTable, steps: int, most: int) -> SampleBlock:
        """The samples after the newest one.

        Args:
            times: The `SampleTimes` of the run.
            held: Inputs from where the run stands on.
            steps: How many steps may be taken.
            most: How many samples may be taken.
        """
        raise NotImplementedError

    def whole(
        self, y: State, first: Array, times: Any, held: HeldTable, steps: int
    ) -> Callable[[], Array | None]:
        """What takes a run from its start to its end at once, again and again.

        Its rows are those of a `SampleBlock`; None where the run stopped earlier.

        Args:
            y: What is integrated at the start.
            first: The first row.
            times: The `SampleTimes` of the run.
            held: Inputs of the whole run.
            steps: How many steps may be taken.
        """
        raise NotImplementedError
