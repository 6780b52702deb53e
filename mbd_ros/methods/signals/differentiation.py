"""Velocity and acceleration from sampled positions, causally or for complete recordings.

`CausalDifferentiator` runs live and lags by a known delay. `local_polynomials` and
`motion/filters.py` have no lag, but need the complete recording.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError

TURN = 2.0 * math.pi
_ONE_PERCENT = {2: 6.6384, 3: 8.4059}  # roots of exp(-x) sum_{k < order} x^k/k! = 0.01
_HALF_TURN = 0.499  # turns; beyond, rounding decides in which direction a joint turned
_SLOWEST, _FASTEST = 1.0e-6, 1.0e9  # cut-off frequencies [Hz] whose powers do not overflow
_DEGREE = 4


class CausalDifferentiator:
    """Causal differentiation of joint positions, sample by sample.

    Positions are not filtered. A joint with a measured velocity keeps it, and its acceleration
    comes from a second-order `LowPass`; any other joint gets both from a third-order one. The
    output of a filter lags by its `delay`.

    Args:
        cutoff: Half-power frequency of the filters [Hz], > 0.
        velocity_limit: Velocity beyond which a position step counts as an encoder glitch [rad/s or
            m/s], shape (n,); inf for no limit. A step that agrees within limit x dt with the
            measured velocity or, without one, with the previous step, is not a glitch.
        wraps: Joints whose angle may jump by full turns, shape (n,) of bool.
        patience: After this many glitches in a row the filters restart at the new position.
        rewind: A stamp that is older than the last one by more than this restarts the filters [s].

    Attributes:
        position: Unwrapped positions [rad or m], shape (n,).
        velocity: Velocities [rad/s or m/s], shape (n,).
        acceleration: Accelerations [rad/s^2 or m/s^2], shape (n,).
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
        """Discard all samples, so that the next one is the first."""
        self._stamp: int | None = None
        self._jumps, self._last_step, self._all_measured = 0, 0, False
        self._position_runs, self._before = False, (np.zeros(len(self._ones)), self._rewind)

    def checkpoint(self) -> tuple[Any, ...]:
        """Return everything on which the verdict and the result of the next sample depend."""
        filters = self._of_position.checkpoint(), self._of_velocity.checkpoint()
        outputs = self.position, self.velocity, self.acceleration, self._measured
        verdict = self._stamp, self._jumps, self._last_step, self._before
        return filters, outputs, verdict, (self._all_measured, self._position_runs)

    def restore(self, checkpoint: tuple[Any, ...]) -> None:
        """Return to the state in which `checkpoint` was taken."""
        filters, outputs, verdict, (self._all_measured, self._position_runs) = checkpoint
        self._of_position.restore(filters[0])
        self._of_velocity.restore(filters[1])
        self.position, self.velocity, self.acceleration, self._measured = outputs
        self._stamp, self._jumps, self._last_step, self._before = verdict

    def update(
        self,
        stamp: int,
        position: Array,
        velocity: Array,
        since: NDArray[np.int64] | None = None,
    ) -> SampleStatus:
        """Process the next sample.

        Args:
            stamp: Time [ns].
            position: Positions [rad or m], shape (n,).
            velocity: Velocities [rad/s or m/s], not finite where not measured, shape (n,).
            since: Time since the last sample of each joint [ns], shape (n,), if joints were
                missing in the last sample.

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
        """Process many samples at once, if `update` would accept all of them.

        The result agrees with that of calling `update` for each sample to rounding.

        Args:
            stamps: Times [ns], shape (m,), m > 0.
            position: Positions [rad or m], shape (m, n).
            velocity: Velocities [rad/s or m/s], not finite where not measured, shape (m, n).

        Returns:
            Position, velocity and acceleration, shape (m, n) each; None, without any effect, at
            the beginning, if a verdict other than USED is possible, or if a measured velocity
            ceases.
        """
        if self._stamp is None:
            return None
        steps = np.diff(stamps, prepend=self._stamp)
        measured = np.isfinite(velocity)
        if (steps <= 0).any() or (measured & self._measured != self._measured).any():
            return None
        with np.errstate(invalid="ignore", over="ignore"):
            position, change = self._unwrap(position)
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

    def _unwrap(self, position: Array) -> tuple[Array, Array]:
        """Return unwrapped positions and their changes, NaN where the direction is ambiguous."""
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
        """Return velocity and acceleration if some joints have no measured velocity."""
        if not self._position_runs:
            slope = (position[0] - self.position) / (steps[0] * NANOSECOND)
            self._of_position.start(self.position, slope)
            self._position_runs = True
        _, rates, second = self._of_position.run(position, steps)
        rates = np.where(self._measured, velocity, rates)
        return rates, np.where(self._measured, self._of_velocity.run(rates, steps)[1], second)

    def _is_glitch(self, rate: Array, velocity: Array) -> bool:
        """Return whether a joint exceeds its limit against its measured velocity or last step."""
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
        """Differentiate positions; joints without velocity once count as such until a reset."""
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


class SampleStatus(Enum):
    """The verdict on a sample."""

    USED = "used"
    DUPLICATE = "duplicate stamp"
    OLD = "stamp older than the last"
    JUMP = "jump beyond the velocity limit"
    RESTARTED = "restarted"
    NOT_FINITE = "position NaN or infinite"
    INCOMPLETE = "joints missing for too long"


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
        self._last = np.zeros((order + 1, size))  # y, then u; a new array each step
        self.state = np.zeros((order, size))
        self._terms = self._terms_of_step(order)
        self._step, self._product = 0, np.zeros((order + 1, order + 2))

    def start(self, signal: Array, slope: Array | float) -> None:
        """Begin in the steady response to a signal with a constant slope."""
        self._last = np.zeros_like(self._last)
        self._last[0] = signal - self.delay * slope
        self._last[1] = slope
        self._last[-1] = signal
        self.state = self._last[:-1]

    def update(self, signal: Array, step: int) -> None:
        """Advance to a new sample.

        Args:
            signal: Newest sample, shape (size,).
            step: Time since the last one [ns], > 0.
        """
        if step != self._step:
            self._choose(step)
        self._rows[:-1], self._rows[-1] = self._last, signal
        self._last = self._product.dot(self._rows)
        self.state = self._last[:-1]

    def _choose(self, step: int) -> None:
        """Select the transition matrices of a step [ns]."""
        h = step * NANOSECOND
        e = math.exp(-self._w * h)
        weights = np.array((e, e * h, e * h * h, e / h, 1.0, 1.0 / h))
        weights.dot(self._terms, self._product.reshape(-1))
        self._step = step

    def run(self, signals: Array, steps: NDArray[np.int64]) -> Array:
        """Advance to many samples; equals `update` for each one to rounding.

        The samples are cut into as many stretches as one has samples. All stretches are passed at
        once as if each began at rest; what one hands to the next decays by D of the time since.

        Args:
            signals: One sample a row, shape (n, size), n > 0.
            steps: Time since the sample before [ns], > 0, shape (n,).

        Returns:
            Filtered signals and derivatives, shape (order, n, size).
        """
        n, size, order = *signals.shape, len(self.state)
        length = math.isqrt(n - 1) + 1
        count = -(-n // length)
        h = np.full(count * length, steps[-1] * NANOSECOND)
        h[:n] = steps * NANOSECOND
        h = _folded(h, length)
        if (steps == steps[0]).all():
            self._choose(int(steps[0]))
            D, K = np.split(self._product[None, :order, :, None], [order], axis=2)
            D, h = np.broadcast_to(D, (length, order, order, 1)), h[:, :1]
        else:
            D, K = self._decay(h), self._gain(h)
        u, before = np.zeros((2, count * length, size))
        u[:n], before[0], before[1:n] = signals, self._last[-1], signals[:-1]
        u, before = _folded(u, length), _folded(before, length)
        y = np.empty((length, order, count, size))
        for row in range(order):
            y[:, row] = K[:, row, 0, :, None] * before + K[:, row, 1, :, None] * u
        for k in range(1, length):
            y[k] += _product(D[k], y[k - 1])
        self._connect(y, self._decay(h.cumsum(axis=0)))
        states = y.transpose(1, 2, 0, 3).reshape(order, count * length, size)[:, :n]
        self._last = np.concatenate((states[:, -1], signals[-1:]))
        self.state = self._last[:-1]
        return states

    def _connect(self, y: Array, since: Array) -> None:
        """Add the response to the state before each stretch to stretches that begin at rest.

        Args:
            y: Shape (length, order, count, size).
            since: D of the time since the stretch began, shape (length, order, order, count), or
                1 in place of the count where all are alike.
        """
        left, state = np.empty_like(y[0]), self._last[:-1]
        for b in range(len(left[0])):
            left[:, b] = state
            state = since[-1, ..., min(b, since.shape[-1] - 1)] @ state + y[-1, :, b]
        for k in range(len(y)):
            y[k] += _product(since[k], left)

    def _decay(self, h: Array) -> Array:
        """Return D at times [s] of shape (k, m), shape (k, order, order, m)."""
        e = np.exp(-self._w * h)
        return self._summed((e, e * h, e * h * h), slice(0, len(self.state)))

    def _gain(self, h: Array) -> Array:
        """Return K+ - D K at times [s] of shape (k, m), > 0, shape (k, order, 2, m)."""
        e = np.exp(-self._w * h)
        weights = (e, e * h, e * h * h, e / h, np.ones_like(h), 1.0 / h)
        return self._summed(weights, slice(len(self.state), None))

    def _summed(self, weights: Sequence[Array], columns: slice) -> Array:
        order = len(self.state)
        terms = self._terms.reshape(-1, order + 1, order + 2)[: len(weights), :order, columns]
        summed: Array = np.einsum("wkm,wrc->krcm", np.array(weights), terms)
        return summed

    def checkpoint(self) -> Array:
        """Return the state on which the next steps depend."""
        return self._last

    def restore(self, checkpoint: Array) -> None:
        """Return to the state in which `checkpoint` was taken."""
        self._last = checkpoint
        self.state = checkpoint[:-1]

    def _terms_of_step(self, order: int) -> Array:
        """Return the factors of e, e h, e h^2, e/h, 1 and 1/h in [D, K+ - D K], e = exp(-w h).

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


def _folded(values: Array, length: int) -> Array:
    """Return samples in the order (index in their stretch, stretch), contiguous."""
    stretches = values.reshape(-1, length, *values.shape[1:])
    return np.ascontiguousarray(stretches.swapaxes(0, 1))


def _product(D: Array, y: Array) -> Array:
    """Return D y of every stretch, shapes (order, order, m) and (order, count, size)."""
    terms = D[..., None] * y
    product: Array = terms[:, 0] + terms[:, 1]
    for column in range(2, len(y)):
        product += terms[:, column]
    return product


def local_polynomials(
    stamps: NDArray[np.int64],
    position: Array,
    velocity: Array | None = None,
    *,
    half_width: int,
) -> tuple[Array, Array]:
    """Return velocity and acceleration of a complete recording, without lag.

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


def _local_derivatives(stamps: NDArray[np.int64], half_width: int) -> tuple[Array, Array]:
    """Return weights of samples in the first and second derivative, shape (n, width) each."""
    starts = _window_starts(len(stamps), half_width)
    windows = starts[:, None] + np.arange(2 * half_width + 1)
    t = (stamps[windows] - stamps[:, None]) * NANOSECOND
    span = np.ptp(t, axis=1)[:, None]
    vandermonde = (t / span)[:, :, None] ** np.arange(_DEGREE + 1)
    weights = np.linalg.pinv(vandermonde)
    return weights[:, 1] / span, 2.0 * weights[:, 2] / span**2


def _window_starts(samples: int, half_width: int) -> NDArray[np.intp]:
    width = 2 * half_width + 1
    if half_width < _DEGREE // 2 or samples < width:
        raise DataError(
            f"zero-phase derivatives with half width {half_width} need half width >= "
            f"{_DEGREE // 2} and at least {width} samples, there are {samples}"
        )
    return np.clip(np.arange(samples) - half_width, 0, samples - width)
