"""The rhythm of a node that ticks: when the next tick is due, and how late the last ones were."""

from contextlib import suppress
from pathlib import Path
from time import perf_counter

import numpy as np
from rclpy.executors import Executor

# An executor wakes up some 0.1 ms late, and an rclpy timer with it. Here it is asked for this much
# too early, and a loop waits for the rest. More would cost more CPU than it brings: where cores
# are short, who computes less is woken sooner.
MARGIN = 2.0e-4  # s
_HEARING = 1.0e-3  # [s] without callbacks at most, also while ticks are late
_HEARD = 8  # callbacks at a time then
PATIENCE = 0.1  # [s] that late ticks may catch up, and that a wait lasts at most


class Pace:
    """Ticks on a grid of the steady clock; late ones catch up, those too late move the grid.

    Args:
        period: Simulated time of a tick [s].
        factor: Simulated seconds per second; 0 is as fast as possible.

    Attributes:
        due: When the next tick begins, on the clock of `perf_counter` [s].
        overruns: Ticks that ended after the next one was due.
        given_up: By how much the grid was moved since the start [s].
    """

    def __init__(self, period: float, factor: float) -> None:
        self._period = period
        self.overruns = 0
        self.given_up = 0.0
        self._is_interrupted = False
        self.restart(factor)

    def restart(self, factor: float | None = None) -> None:
        """Begin now, with nothing to catch up; the counts stay."""
        if factor is not None:
            self.factor = factor
            self._interval = self._period / factor if factor > 0.0 else 0.0
        self.due = self._heard = perf_counter()
        self.open_window()

    def skip(self) -> None:
        """Leave the present tick out."""
        self.due += self._interval

    def open_window(self) -> None:
        """Begin a new period of `reached` and `lateness`."""
        self._since = perf_counter()
        self._given_up_before = self.given_up
        self._lateness: list[float] = []

    def wait(self, executor: Executor) -> bool:
        """Handle callbacks until the next tick is due: True; False to wait again."""
        now = perf_counter()
        spare = self.due - now - MARGIN
        if spare > PATIENCE:
            self.idle(executor, PATIENCE)
            return False  # a signal must not wait for the next tick
        if spare > 0.0:
            is_due = self.idle(executor, spare)
        else:
            is_due = now - self._heard <= _HEARING or self._hear(executor)
        if not is_due:
            return False
        while (now := perf_counter()) < self.due:
            pass
        self._lateness.append(now - self.due)
        return True

    def idle(self, executor: Executor, seconds: float) -> bool:
        """Handle callbacks for so long [s]: True, or until `interrupt`: False."""
        self._is_interrupted, end = False, perf_counter() + seconds
        # Not spin_until_future_complete: that of an EventsExecutor loses 32 bytes a call.
        while not self._is_interrupted and (left := end - perf_counter()) > 0.0:
            executor.spin_once(timeout_sec=left)
        self._heard = perf_counter()
        return not self._is_interrupted

    def interrupt(self) -> None:
        """End a `wait` or `idle` from within a callback that it handles."""
        self._is_interrupted = True

    def _hear(self, executor: Executor) -> bool:
        """Handle some callbacks that wait: True, or until `interrupt`: False."""
        self._is_interrupted, count = False, 0
        while not self._is_interrupted and count < _HEARD:
            executor.spin_once(timeout_sec=0.0)
            count += 1
        self._heard = perf_counter()
        return not self._is_interrupted

    def ticked(self) -> None:
        """A tick is done: set the time of the next."""
        now = perf_counter()
        self.due += self._interval
        late = now - self.due
        if self._interval == 0.0:
            self.due = now
        elif late > 0.0:
            self.overruns += 1
            if late > PATIENCE:
                self.given_up += late
                self.due = now

    @property
    def ticks(self) -> int:
        """Ticks in this window."""
        return len(self._lateness)

    @property
    def reached(self) -> float:
        """Simulated seconds per second in this window."""
        return self.ticks * self._period / max(perf_counter() - self._since, 1e-9)

    @property
    def lateness(self) -> float:
        """By how much 99 % of the ticks of this window began late at most [s]."""
        return float(np.percentile(self._lateness, 99)) if self._lateness else 0.0

    @property
    def lag(self) -> str:
        """The lag of the factor in this window."""
        reached = f"real-time factor {self.reached:.3f} instead of {self.factor:g}"
        return f"lagging: {reached}, {self.overruns} overruns"

    def details(self, is_running: bool) -> dict[str, str]:
        """How time was kept in this window, for diagnostics."""
        asked = f"{self.factor:g}" if self.factor else "0 (as fast as possible)"
        return {
            "real-time factor asked": asked,
            "real-time factor reached": f"{self.reached:.3f}" if is_running else "standing",
            "ticks since the last report": str(self.ticks),
            "lateness of 99 % of the ticks": f"{self.lateness:.6f}",
            "overruns": str(self.overruns),
            "time given up": f"{self.given_up:.3f}",
        }

    @property
    def is_lagging(self) -> bool:
        """Whether the factor was not kept in this window: time was given up, or is about to be."""
        late = perf_counter() - self.due
        return self.factor > 0.0 and (self.given_up > self._given_up_before or late > PATIENCE / 2)


def wake_exactly(is_exact: bool = True) -> None:
    """Ask Linux to wake the main thread when it is due, not up to 50 us later as by default."""
    with suppress(OSError):  # no Linux, or not allowed: ticks are late a little more often
        Path("/proc/self/timerslack_ns").write_text("1" if is_exact else "0")
