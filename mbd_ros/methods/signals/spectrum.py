"""Density of signals by frequency, clean enough for noise that is 10^-12 of a motion.

A piece of a recording neither begins nor ends at rest. Cut out as it is, it has a spectrum that
falls as f^-2, above all noise. So each piece is faded in and out by a taper with a spectrum that
falls as f^-14 (sin^6), after what a cubic explains of it is gone: a motion keeps its steep fall.

Source: P. D. Welch, IEEE Trans. Audio Electroacoust. 15, 1967, 70 (mean of periodograms of
    tapered pieces); F. J. Harris, Proc. IEEE 66, 1978, 51, section V (powers of sines).
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.methods.signals.spline_basis import product

FEWEST_TELLING = 32  # samples in a piece, from which on noise can be told from motion
_POWER = 4  # of the sine
_CUBIC = 4
_NEAR = 4  # samples that a value between them is taken from
_CLOCK = 5.0e-9  # s: stamps are rounded to some ns


class Spectrum(NamedTuple):
    """Densities of m signals.

    Attributes:
        frequency: k times the first of them, k = 1 .. n [Hz], shape (n,).
        density: One-sided, [unit^2/Hz], shape (n, m).
        span: Of the longest piece [s].
    """

    frequency: Array
    density: Array
    span: float


def spectrum(pieces: Sequence[tuple[Array, Array]]) -> Spectrum:
    """Mean density of pieces of a recording.

    Args:
        pieces: Times [s], shape (n,), and signals, shape (n, m); the longest has at least
            `FEWEST_TELLING` samples. Irregular ones are interpolated.
    """
    longest = max((times for times, _ in pieces), key=len)
    step = float(longest[-1] - longest[0]) / (len(longest) - 1)
    even = [_even(times, values, step) for times, values in pieces]
    size = _good(max(len(values) for values in even))
    total = sum(len(values) for values in even)
    density = np.zeros((pieces[0][1].shape[1], size // 2))
    for values in even:
        density += len(values) / total * _periodogram(values, size)
    frequency = np.arange(1, size // 2 + 1) / (size * step)
    return Spectrum(frequency, 2.0 * step * density.T, float(longest[-1] - longest[0]))


def _periodogram(values: Array, size: int) -> Array:
    """Squares of the Fourier transform of tapered values per sum of squares of the taper."""
    taper, cubics = _taper(len(values))
    faded = np.ascontiguousarray(values.T)
    faded = faded * taper
    faded -= product(product(faded, cubics.T), cubics)
    transformed = np.fft.rfft(faded, size)[:, 1:]
    powers: Array = transformed.real**2 + transformed.imag**2
    return powers / np.square(taper).sum()


@functools.lru_cache(maxsize=2)  # pieces are about as long as each other
def _taper(n: int) -> tuple[Array, Array]:
    """Taper, shape (n,), and tapered cubics, orthonormal, shape (4, n)."""
    places = (np.arange(n) + 0.5) / n
    squared = np.square(np.sin(np.pi * places))
    taper = squared ** (_POWER // 2)
    cubics = np.array([taper * (2.0 * places - 1.0) ** k for k in range(_CUBIC)])
    factor = np.linalg.cholesky(product(cubics, cubics.T))
    return taper, product(np.linalg.inv(factor), cubics)


def _good(size: int) -> int:
    """The next size with no other factors than 2, 3 and 5."""
    while True:
        rest = size
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return size
        size += 1


def _even(times: Array, values: Array, step: float) -> Array:
    """Values at times that are a step apart: those of the cubic through the four next samples."""
    n = int((times[-1] - times[0]) / step + 0.5) + 1
    places = times[0] + step * np.arange(n)
    if n == len(times) and np.abs(places - times).max() <= _CLOCK:
        return values
    at = np.searchsorted(times, places, side="right") - _NEAR // 2
    near = np.clip(at, 0, len(times) - _NEAR)[:, None] + np.arange(_NEAR)
    x = times[near]
    even = np.zeros((n, values.shape[1]))
    for i in range(_NEAR):
        others = [j for j in range(_NEAR) if j != i]
        weight = np.prod([(places - x[:, j]) / (x[:, i] - x[:, j]) for j in others], axis=0)
        even += weight[:, None] * values[near[:, i]]
    return even
