"""Power spectral density of signals, for noise as small as 10^-12 of a motion.

A piece of a recording neither begins nor ends at rest, so its spectrum falls only as f^-2 and
hides the noise. Each piece is therefore multiplied by a taper, a power of a sine whose spectrum
falls steeply, and its best-fitting cubic is removed.

Source: P. D. Welch, IEEE Trans. Audio Electroacoust. 15, 1967, 70 (mean of periodograms of
    tapered pieces); F. J. Harris, Proc. IEEE 66, 1978, 51, section V (powers of sines).
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.methods.signals.spline_basis import product

FEWEST_TELLING = 32  # least number of samples of a piece that separates noise from motion
_POWER = 4  # of the sine
_CUBIC = 4
_NEAR = 4  # samples of an interpolated value
_CLOCK = 5.0e-9  # rounding of stamps [s]


class Spectrum(NamedTuple):
    """Power spectral densities of m signals.

    Attributes:
        frequency: Equidistant frequencies without 0 [Hz], shape (n,).
        density: One-sided density [unit^2/Hz], shape (n, m).
        span: Duration of the longest piece [s].
    """

    frequency: Array
    density: Array
    span: float


def spectrum(pieces: Sequence[tuple[Array, Array]]) -> Spectrum:
    """Return the mean density of the pieces of a recording.

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
    """Return the squared Fourier transform of tapered values over the energy of the taper."""
    taper, cubics = _taper(len(values))
    faded = np.ascontiguousarray(values.T)
    faded = faded * taper
    faded -= product(product(faded, cubics.T), cubics)
    transformed = np.fft.rfft(faded, size)[:, 1:]
    powers: Array = transformed.real**2 + transformed.imag**2
    return powers / np.square(taper).sum()


@functools.lru_cache(maxsize=2)  # pieces are about as long as each other
def _taper(n: int) -> tuple[Array, Array]:
    """Return the taper, shape (n,), and orthonormal tapered cubics, shape (4, n)."""
    places = (np.arange(n) + 0.5) / n
    squared = np.square(np.sin(np.pi * places))
    taper = squared ** (_POWER // 2)
    cubics = np.array([taper * (2.0 * places - 1.0) ** k for k in range(_CUBIC)])
    factor = np.linalg.cholesky(product(cubics, cubics.T))
    return taper, product(np.linalg.inv(factor), cubics)


def _good(size: int) -> int:
    """Return the next size whose prime factors are 2, 3 and 5."""
    while True:
        quotient = size
        for factor in (2, 3, 5):
            while quotient % factor == 0:
                quotient //= factor
        if quotient == 1:
            return size
        size += 1


def _even(times: Array, values: Array, step: float) -> Array:
    """Resample values at a constant step, by the cubic through the four nearest samples."""
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
