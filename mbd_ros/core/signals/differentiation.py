"""Velocity and acceleration from sampled positions, from the past only.

It lags by a stated delay and runs live. `motion/zero_phase.py` sees past and future, does
not lag and needs the whole recording. Neither takes the place of the other.
"""

import math
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.signals.causal_low_pass import TURN, LowPass
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError

_HALF_TURN = 0.499  # of a turn: beyond, rounding decides which way a joint went
_SLOWEST, _FASTEST = 1.0e-6, 1.0e9  # cut-off frequencies [Hz] whose powers are numbers


class SampleStatus(Enum):
    """The verdict on a sample."""

    USED = "used"
    DUPLICATE = "duplicate stamp"
    OLD = "stamp older than the last"
    JUMP = "jump beyond the velocity limit"
    RESTARTED = "restarted"
    NOT_FINITE = "position NaN or infinite"
    INCOMPLETE = "joints missing for too long"


class CausalDifferentiator:
    """Velocity and acceleration of joints from the past only, sample by sample.

    The position passes unchanged. A joint whose velocity is measured keeps that velocity and gets
    its acceleration from a second-order `LowPass`; any other gets both from a third-order one.
    The output of a filter lags by its `delay`.

    Args:
        cutoff: Half-power frequency of the filters [Hz], > 0.
        velocity_limit: Steps beyond limit x dt are rejected as encoder glitches [rad/s or m/s],
            shape (n,); inf for a joint without. A joint that really moves faster is no glitch: its
            step is within limit x dt of what the measured velocity says or, where none is
            measured, of the step before.
        wraps: Joints whose angle may jump by full turns, shape (n,) of bool.
        patience: Number of glitches in a row that are believed: the filters restart there.
        rewind: A stamp older than the last by more than this is a new beginning [s].

    Attributes:
        position: [rad or m], unwrapped, shape (n,).
        velocity: [rad/s or m/s], shape (n,).
        acceleration: [rad/s^2 or m/s^2], shape (n,).
    """

    def __init__(
        self,
        *,
        cutoff: float,
        velocity_limit: Array,
        wraps: NDArray[np.bool_],
        patience: int = 5,
        rewind: float = 1.0,
    ) -> None:
        if not _SLOWEST <= cutoff <= _FASTEST:
            accepted = f"{_SLOWEST:g} .. {_FASTEST:g}"
            raise DataError(f"cutoff {cutoff} Hz must be finite and > 0, accepted: {accepted}")
        size = len(velocity_limit)
        self._wraps = wraps if wraps.any() else None
        self._patience, self._rewind = patience, round(rewind / NANOSECOND)
        self._of_position, self._of_velocity = LowPass(3, cutoff, size), LowPass(2, cutoff, size)
        self._measured = np.zeros(size, dtype=np.bool_)
        self._limit, self._ones = velocity_limit, np.ones(size)
        self._smallest_limit = float(velocity_limit.min(initial=math.inf))
        self.position, self.velocity, self.acceleration = (np.zeros(size) for _ in range(3))
        self.reset()

    @property
    def delay(self) -> float:
        """Largest lag of velocity and acceleration [s]."""
        return self._slowest.delay

    @property
    def settling_time(self) -> float:
        """Time after a start until the derivatives can be trusted to 1 % [s]."""
        return self._slowest.settling_time

    @property
    def _slowest(self) -> LowPass:
        return self._of_velocity if self._all_measured else self._of_position

    def reset(self) -> None:
        """Forget everything; the next sample is a beginning."""
        self._stamp: int | None = None
        self._jumps, self._last_step, self._all_measured = 0, 0, False
        self._position_runs, self._before = False, (np.zeros(len(self._ones)), self._rewind)

    @property
    def memory(self) -> tuple[Any, ...]:
        """State by which the next samples are judged; may be set, to its value before a sample."""
        filters = self._of_position.memory, self._of_velocity.memory
        answer = self.position, self.velocity, self.acceleration, self._measured
        judged = self._stamp, self._jumps, self._last_step, self._before
        return filters, answer, judged, (self._all_measured, self._position_runs)

    @memory.setter
    def memory(self, memory: tuple[Any, ...]) -> None:
        filters, answer, judged, (self._all_measured, self._position_runs) = memory
        self._of_position.memory, self._of_velocity.memory = filters
        self.position, self.velocity, self.acceleration, self._measured = answer
        self._stamp, self._jumps, self._last_step, self._before = judged

    def update(
        self,
        stamp: int,
        position: Array,
        velocity: Array,
        since: NDArray[np.int64] | None = None,
    ) -> SampleStatus:
        """Take the next sample.

        Args:
            stamp: Time [ns].
            position: [rad or m], shape (n,).
            velocity: [rad/s or m/s], not finite where not measured, shape (n,).
            since: Time since the last sample of each joint [ns], shape (n,), where that is not the
                last sample of all.

        Returns:
            The verdict. After OLD, JUMP and NOT_FINITE the attributes are those of the last
            good sample.
        """
        if self._stamp is None:
            return self._start(stamp, position, velocity, SampleStatus.USED)
        step = stamp - self._stamp
        if step < 0:
            if -step <= self._rewind:
                return SampleStatus.OLD
            return self._start(stamp, position, velocity, SampleStatus.RESTARTED)
        change = position - self.position
        if self._wraps is not None:
            change -= np.where(self._wraps, TURN * np.rint(change / TURN), 0.0)
            position = np.where(self._wraps, self.position + change, position)
        least = step or self._last_step
        h = least * NANOSECOND
        if not change.dot(change) < (self._smallest_limit * h) ** 2:  # else no joint is too fast
            if not np.isfinite(change).all():
                return SampleStatus.NOT_FINITE
            elapsed = h if since is None else np.maximum(since, least) * NANOSECOND
            if self._is_glitch(change / elapsed, velocity):
                self._jumps += 1
                if self._jumps < self._patience:
                    return SampleStatus.JUMP
                started = self._start(stamp, position, velocity, SampleStatus.RESTARTED)
                self._before = change, least
                return started
        if step == 0:
            self.position = position
            return SampleStatus.DUPLICATE
        if self._all_measured and math.isfinite(velocity.dot(self._ones)):
            self._of_velocity.update(velocity, step)
            self.velocity, self.acceleration = velocity, self._of_velocity.state[1]
        else:
            self._derive(step, position, velocity)
        self.position, self._stamp, self._jumps = position, stamp, 0
        self._last_step, self._before = step, (change, step)
        return SampleStatus.USED

    def update_all(
        self, stamps: NDArray[np.int64], position: Array, velocity: Array
    ) -> tuple[Array, Array, Array] | None:
        """Take many samples at once, where all of them pass, as `update` one by one, to rounding.

        Args:
            stamps: Times [ns], shape (m,), m > 0.
            position: [rad or m], shape (m, n).
            velocity: [rad/s or m/s], not finite where not measured, shape (m, n).

        Returns:
            Position, velocity and acceleration, shape (m, n) each; None, and nothing changes, at
            a beginning and where a sample may be anything but USED, or where a joint ceases to be
            measured.
        """
        if self._stamp is None:
            return None
        steps = np.diff(stamps, prepend=self._stamp)
        measured = np.isfinite(velocity)
        if (steps <= 0).any() or (measured & self._measured != self._measured).any():
            return None
        with np.errstate(invalid="ignore", over="ignore"):
            position, change = self._followed(position)
            slow = np.abs(change) <= self._limit * (steps * NANOSECOND)[:, None]
        if not (slow.all() and np.isfinite(change).all()):
            return None
        if self._all_measured:
            rates = velocity
            acceleration = self._of_velocity.run(rates, steps)[1]
        else:
            rates, acceleration = self._derive_all(steps, position, velocity)
        self.position, self.velocity, self.acceleration = (
            values[-1] for values in (position, rates, acceleration)
        )
        self._stamp, self._jumps, self._last_step = int(stamps[-1]), 0, int(steps[-1])
        self._before = change[-1], self._last_step
        return position, rates, acceleration

    def _followed(self, position: Array) -> tuple[Array, Array]:
        """Positions without their full turns, and their changes; NaN where that is not clear."""
        change = np.diff(position, axis=0, prepend=self.position[None])
        if self._wraps is None:
            return position, change
        turns = np.where(self._wraps, change / TURN, 0.0)
        whole = np.rint(turns)
        change = np.where(np.abs(turns - whole) < _HALF_TURN, change - TURN * whole, np.nan)
        return position - TURN * np.cumsum(whole, axis=0), change

    def _derive_all(
        self, steps: NDArray[np.int64], position: Array, velocity: Array
    ) -> tuple[Array, Array]:
        """Velocity and acceleration where some joints come without velocity."""
        if not self._position_runs:
            slope = (position[0] - self.position) / (steps[0] * NANOSECOND)
            self._of_position.start(self.position, slope)
            self._position_runs = True
        _, rates, second = self._of_position.run(position, steps)
        rates = np.where(self._measured, velocity, rates)
        return rates, np.where(self._measured, self._of_velocity.run(rates, steps)[1], second)

    def _is_glitch(self, rate: Array, velocity: Array) -> bool:
        """Whether a joint is faster than its limit, and nothing says that it really moves so."""
        change, step = self._before
        with np.errstate(invalid="ignore", over="ignore"):
            before = change / (step * NANOSECOND)
            expected = np.where(np.isfinite(velocity), 0.5 * (self.velocity + velocity), before)
            too_fast = np.abs(rate) > self._limit
            unexpected = np.abs(rate - expected) > self._limit
        return bool((too_fast & unexpected).any())

    def _start(
        self, stamp: int, position: Array, velocity: Array, outcome: SampleStatus
    ) -> SampleStatus:
        if not np.isfinite(position).all():
            return SampleStatus.NOT_FINITE
        self._measured = np.isfinite(velocity)
        self._all_measured = bool(self._measured.all())
        self.position = position
        self.velocity = np.where(self._measured, velocity, 0.0)
        self.acceleration = np.zeros_like(position)
        self._of_velocity.start(self.velocity, 0.0)
        self._position_runs = False
        self._stamp, self._jumps, self._last_step = stamp, 0, self._rewind
        self._before = np.zeros(len(position)), self._rewind
        return outcome

    def _derive(self, step: int, position: Array, velocity: Array) -> None:
        """A joint that came without velocity once is derived from its position until a reset."""
        measured = self._measured = self._measured & np.isfinite(velocity)
        self._all_measured = False
        if not self._position_runs:
            slope = (position - self.position) / (step * NANOSECOND)
            self._of_position.start(self.position, slope)
            self._position_runs = True
        self._of_position.update(position, step)
        _, derived_velocity, derived_acceleration = self._of_position.state
        self.velocity = np.where(measured, velocity, derived_velocity)
        self._of_velocity.update(self.velocity, step)
        self.acceleration = np.where(measured, self._of_velocity.state[1], derived_acceleration)
