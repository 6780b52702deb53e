"""Low-pass filters whose derivatives come out, stepped exactly at irregular times."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array

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
        self._last = np.zeros((order + 1, size))  # y, then u; a new array each step
        self.state = np.zeros((order, size))
        self._terms = self._terms_of_step(order)
        self._step, self._product = 0, np.zeros((order + 1, order + 2))

    def start(self, signal: Array, slope: Array | float) -> None:
        """Begin in the steady response to a signal of that slope."""
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
        """Make `_product` that of a step [ns]."""
        h = step * NANOSECOND
        e = math.exp(-self._w * h)
        weights = np.array((e, e * h, e * h * h, e / h, 1.0, 1.0 / h))
        weights.dot(self._terms, self._product.reshape(-1))
        self._step = step

    def run(self, signals: Array, steps: NDArray[np.int64]) -> Array:
        """Advance to many samples, as `update` does one by one, to rounding.

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
        found = y.transpose(1, 2, 0, 3).reshape(order, count * length, size)[:, :n]
        self._last = np.concatenate((found[:, -1], signals[-1:]))
        self.state = self._last[:-1]
        return found

    def _connect(self, y: Array, since: Array) -> None:
        """Add to stretches that begin at rest what the ones before leave, in place.

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
        """D of times [s] of shape (k, m), shape (k, order, order, m)."""
        e = np.exp(-self._w * h)
        return self._summed((e, e * h, e * h * h), slice(0, len(self.state)))

    def _gain(self, h: Array) -> Array:
        """K+ - D K of times [s] of shape (k, m), > 0, shape (k, order, 2, m)."""
        e = np.exp(-self._w * h)
        weights = (e, e * h, e * h * h, e / h, np.ones_like(h), 1.0 / h)
        return self._summed(weights, slice(len(self.state), None))

    def _summed(self, weights: Sequence[Array], columns: slice) -> Array:
        order = len(self.state)
        terms = self._terms.reshape(-1, order + 1, order + 2)[: len(weights), :order, columns]
        summed: Array = np.einsum("wkm,wrc->krcm", np.array(weights), terms)
        return summed

    @property
    def memory(self) -> Array:
        """State on which the next steps depend; may be set, to an earlier value."""
        return self._last

    @memory.setter
    def memory(self, kept: Array) -> None:
        self._last, self.state = kept, kept[:-1]

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


def _folded(values: Array, length: int) -> Array:
    """Samples in the order (place in their stretch, stretch), contiguous."""
    stretches = values.reshape(-1, length, *values.shape[1:])
    return np.ascontiguousarray(stretches.swapaxes(0, 1))


def _product(D: Array, y: Array) -> Array:
    """D y of every stretch, shapes (order, order, m) and (order, count, size)."""
    terms = D[..., None] * y
    product: Array = terms[:, 0] + terms[:, 1]
    for column in range(2, len(y)):
        product += terms[:, column]
    return product
