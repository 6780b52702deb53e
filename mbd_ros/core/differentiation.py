"""Velocity and acceleration from sampled positions.

Two ways, never to be mistaken for each other: `CausalDifferentiator` sees the past only, lags by a
stated delay and runs live; `zero_phase` sees past and future, does not lag and needs the whole
recording.
"""

import math
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError

NANOSECOND = 1.0e-9
TURN = 2.0 * math.pi
_ONE_PERCENT = {2: 6.6384, 3: 8.4059}  # roots of exp(-x) sum_{k < order} x^k/k! = 0.01


class LowPass:
    """Critically damped low-pass (s/w + 1)^-order of several signals, with its derivatives.

    A signal u that is linear between samples is followed exactly, whatever the step. Its steady
    response is y_s = [u - delay u', u', 0], and the distance from that decays by
    D = exp(-w h) (I + N h + N^2 h^2 / 2), N nilpotent. Hence one product a step,

        y+ = D y + (K+ - D K) [u, u+]

    where K and K+ map [u, u+] to y_s at either end of the step.

    Args:
        order: Number of coincident poles, 2 or 3; derivatives up to order - 1 come out.
        cutoff: Frequency of half power (-3 dB) [Hz], > 0.
        size: Number of signals.

    Attributes:
        delay: Lag behind slow signals, order / w [s].
        settling_time: Time until a step of the signal is followed to 1 % [s].
        state: Filtered signal and its derivatives, shape (order, size); a new array each step.

    Source: D. G. E. Robertson, J. J. Dowling, J. Electromyogr. Kinesiol. 13, 2003, 569-573
        (critically damped filters and their cutoff); the exact step is the variation of constants.
    """

    def __init__(self, order: int, cutoff: float, size: int) -> None:
        self._w = TURN * cutoff / math.sqrt(2.0 ** (1.0 / order) - 1.0)
        self.delay = order / self._w
        self.settling_time = _ONE_PERCENT[order] / self._w
        self._rows = np.zeros((order + 2, size))  # y, then u of the last and of this step
        self._kept, self._newest = self._rows[:-1], self._rows[-1]
        self.state = np.zeros((order, size))
        self._terms = self._terms_of_step(order)
        self._step, self._product = 0, np.zeros((order + 1, order + 2))

    def start(self, signal: Array, slope: Array | float) -> None:
        """Begin in the steady response to a signal of that slope."""
        self._kept[:] = 0.0
        self._kept[0] = signal - self.delay * slope
        self._kept[1] = slope
        self._kept[-1] = signal
        self.state = self._kept[:-1].copy()

    def update(self, signal: Array, step: int) -> None:
        """Advance to a new sample.

        Args:
            signal: Newest sample, shape (size,).
            step: Time since the last one [ns], > 0.
        """
        if step != self._step:
            h = step * NANOSECOND
            e = math.exp(-self._w * h)
            weights = np.array((e, e * h, e * h * h, e / h, 1.0, 1.0 / h))
            weights.dot(self._terms, self._product.reshape(-1))
            self._step = step
        self._newest[:] = signal
        self._kept[:] = following = self._product.dot(self._rows)
        self.state = following[:-1]

    def _terms_of_step(self, order: int) -> Array:
        """Factors of e, e h, e h^2, e/h, 1 and 1/h in [D, K+ - D K], with e = exp(-w h).

        A last row keeps u+ as the u of the next step.
        """
        N = np.diag(np.ones(order - 1), 1) + self._w * np.eye(order)
        N[-1] -= [math.comb(order, k) * self._w ** (order - k) for k in range(order)]
        I, N2, none = np.eye(order), N @ N / 2.0, np.zeros((order, order))  # noqa: E741
        last, newest, slope = (np.zeros((order, 2)) for _ in range(3))
        last[0, 0] = newest[0, 1] = 1.0
        slope[:2] = [self.delay, -self.delay], [-1.0, 1.0]
        blocks = [
            (I, -(last + N @ slope)),
            (N, -(N @ last + N2 @ slope)),
            (N2, -N2 @ last),
            (none, -slope),
            (none, newest),
            (none, slope),
        ]
        terms = np.zeros((len(blocks), order + 1, order + 2))
        terms[:, :order] = [np.hstack(block) for block in blocks]
        terms[4, -1, -1] = 1.0
        return terms.reshape(len(blocks), -1)


class Sample(Enum):
    """What became of a sample."""

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
    What a filter gives lags by its `delay`.

    Args:
        cutoff: Half-power frequency of the filters [Hz], > 0.
        velocity_limit: Steps beyond limit x dt are rejected as encoder glitches [rad/s or m/s],
            shape (n,); inf for a joint without.
        wraps: Joints whose angle may jump by full turns, shape (n,) of bool.
        patience: So many glitches in a row are believed: the filters restart there.
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
        if not (math.isfinite(cutoff) and cutoff > 0):
            raise DataError(f"cutoff {cutoff} Hz must be finite and > 0")
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

    def update(self, stamp: int, position: Array, velocity: Array) -> Sample:
        """Take the next sample.

        Args:
            stamp: Time [ns].
            position: [rad or m], shape (n,).
            velocity: [rad/s or m/s], not finite where not measured, shape (n,).

        Returns:
            What became of it. After OLD, JUMP and NOT_FINITE the attributes are those of the last
            good sample.
        """
        if self._stamp is None:
            return self._start(stamp, position, velocity, Sample.USED)
        step = stamp - self._stamp
        if step < 0:
            if -step <= self._rewind:
                return Sample.OLD
            return self._start(stamp, position, velocity, Sample.RESTARTED)
        change = position - self.position
        if self._wraps is not None:
            change -= np.where(self._wraps, TURN * np.rint(change / TURN), 0.0)
            position = np.where(self._wraps, self.position + change, position)
        h = (step or self._last_step) * NANOSECOND
        if not change.dot(change) < (self._smallest_limit * h) ** 2:  # else no joint is too fast
            if not np.isfinite(change).all():
                return Sample.NOT_FINITE
            if (np.abs(change) > self._limit * h).any():
                self._jumps += 1
                if self._jumps < self._patience:
                    return Sample.JUMP
                return self._start(stamp, position, velocity, Sample.RESTARTED)
        if step == 0:
            self.position = position
            return Sample.DUPLICATE
        if self._all_measured and math.isfinite(velocity.dot(self._ones)):
            self._of_velocity.update(velocity, step)
            self.velocity, self.acceleration = velocity, self._of_velocity.state[1]
        else:
            self._derive(step, position, velocity)
        self.position, self._stamp, self._jumps = position, stamp, 0
        self._last_step = step
        return Sample.USED

    def _start(self, stamp: int, position: Array, velocity: Array, outcome: Sample) -> Sample:
        if not np.isfinite(position).all():
            return Sample.NOT_FINITE
        self._measured = np.isfinite(velocity)
        self._all_measured = bool(self._measured.all())
        self.position = position
        self.velocity = np.where(self._measured, velocity, 0.0)
        self.acceleration = np.zeros_like(position)
        self._of_velocity.start(self.velocity, 0.0)
        self._position_runs = False
        self._stamp, self._jumps, self._last_step = stamp, 0, self._rewind
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


def zero_phase(
    stamps: NDArray[np.int64],
    position: Array,
    velocity: Array | None = None,
    *,
    half_width: int = 4,
) -> tuple[Array, Array]:
    """Velocity and acceleration of a whole recording, without lag.

    A polynomial of degree 4 is fitted by least squares to each sample and `half_width` neighbours
    on either side; its derivatives at the sample are the result. The first and last `half_width`
    samples use the outermost full window, which is no longer centred on them. Measured velocities
    are kept and differentiated once.

    Args:
        stamps: Sample times [ns], increasing, may be irregular, shape (n,).
        position: [rad or m], shape (n, m).
        velocity: [rad/s or m/s], shape (n, m); a column with a NaN is not used. None: not
            measured.
        half_width: Neighbours on either side, 2 or more.

    Returns:
        Velocity and acceleration, shape (n, m) each.

    Raises:
        DataError: Fewer samples than a window.

    Source: A. Savitzky, M. J. E. Golay, Anal. Chem. 36, 1964, 1627, for irregular samples.
    """
    first, second = _local_derivatives(stamps, half_width)
    starts = _window_starts(len(stamps), half_width)
    windows = starts[:, None] + np.arange(2 * half_width + 1)
    derived = np.einsum("nw,nwm->nm", first, position[windows])
    acceleration = np.einsum("nw,nwm->nm", second, position[windows])
    if velocity is None:
        return derived, acceleration
    measured = ~np.isnan(velocity).any(axis=0)
    kept = np.where(measured, velocity, derived)
    differentiated = np.einsum("nw,nwm->nm", first, kept[windows])
    return kept, np.where(measured, differentiated, acceleration)


_DEGREE = 4


def _window_starts(samples: int, half_width: int) -> NDArray[np.intp]:
    width = 2 * half_width + 1
    if half_width < _DEGREE // 2 or samples < width:
        raise DataError(
            f"zero-phase derivatives with half width {half_width} need half width >= "
            f"{_DEGREE // 2} and at least {width} samples, there are {samples}"
        )
    return np.clip(np.arange(samples) - half_width, 0, samples - width)


def _local_derivatives(stamps: NDArray[np.int64], half_width: int) -> tuple[Array, Array]:
    """Weights of the window's samples in the first and second derivative, shape (n, width)."""
    starts = _window_starts(len(stamps), half_width)
    windows = starts[:, None] + np.arange(2 * half_width + 1)
    t = (stamps[windows] - stamps[:, None]) * NANOSECOND
    span = np.ptp(t, axis=1)[:, None]
    vandermonde = (t / span)[:, :, None] ** np.arange(_DEGREE + 1)
    weights = np.linalg.pinv(vandermonde)
    return weights[:, 1] / span, 2.0 * weights[:, 2] / span**2
