"""Choose the cutoff frequency of a recording from its spectrum, where noise exceeds motion.

A motion has little acceleration at high frequencies, since forces are finite, whereas the
acceleration of noise grows with frequency. In the power spectral density P(f) of positions
[rad^2/Hz], motion falls steeper than f^-3 and noise does not: encoders and clocks cause f^0;
velocities with white noise, steps and repeated samples cause f^-2. Noise may end at a higher
frequency (in a resampled recording). So noise starts at the lowest frequency from which on P stays
flat for some bands and beyond which no motion rises above it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.methods.signals.smoothing_spline import HIGHEST, rate_of, response
from mbd_ros.methods.signals.spectrum import FEWEST_TELLING, Spectrum, spectrum
from mbd_ros.methods.signals.spline_basis import product

LOWEST = 2.0  # Hz: below, even a poor encoder gives no acceleration worth mentioning
_RATIO = np.sqrt(2.0)  # from band to band
_STEEPEST = 3  # noise falls slower than f^-3
_BANDS = 3  # that must look like noise in a row
_RISE = 1.5  # least rise of f^3 P over them
_HUMP = 10.0  # rise of the density with the frequency that only motion has
_SHARE = 0.005  # largest share of the variance that noise has, unless it is white
_WHITE = 6  # bands up to the last that make noise white
_RENEWED = 1 / 8  # largest cut-off per rate of new values, where samples are repeated
_HELD = 4  # samples a level, from which on a few levels are steps of an encoder
_FIRST = 1000  # differences
_AT_END = 3.49, 1.053  # of positions and velocities: the low-pass of t^4 / 4! on a grid
_EXACT = 1.0e-14  # noise per largest value that is rounding of numbers
_GENEROUS = 2.0  # times the least expected square error: motion lost is worse than noise left
_FEW = 256  # samples in which noise may hide


def cutoffs(pieces: Sequence[tuple[Array, Array]], order: int) -> Array:
    """The cut-off at which the expected error of the acceleration is smallest, for each signal.

    Args:
        pieces: Times [s], shape (n,), and signals, shape (n, m), in one or several pieces.
        order: 0 for positions, 1 for velocities.

    Returns:
        [Hz], shape (m,); inf where there is no noise, or too little to tell.
    """
    longest, m = max(pieces, key=lambda piece: len(piece[0]))[0], pieces[0][1].shape[1]
    if len(longest) < FEWEST_TELLING:
        return np.full(m, np.inf)
    bands = _bands(spectrum(pieces), order, _frequencies(longest))
    signals = [functools.partial(_column, pieces, k) for k in range(m)]
    best = np.array([_best(bands, *each) for each in enumerate(signals)])
    repeats = np.any(
        [(np.diff(values, axis=0) == 0.0).any(axis=0) for _, values in pieces], axis=0
    )
    renewals = [_renewals(signals[k]()) if repeats[k] else np.inf for k in range(m)]
    fresh = np.array(renewals) * rate_of(longest)
    return np.minimum(best, np.maximum(_RENEWED * fresh, LOWEST))


def _bands(spectrum_of_pieces: Spectrum, order: int, cutoff: Array) -> Bands:
    """The part that the low-pass of a cut-off does not pass and that of the next does."""
    turn = np.square(2.0 * np.pi * spectrum_of_pieces.frequency)
    ones, m = np.ones_like(turn), spectrum_of_pieces.density.shape[1]
    passed = np.array([*(response(spectrum_of_pieces.frequency, f) for f in cutoff), ones])
    share = np.diff(passed, axis=0)
    np.square(share, out=share)
    to_acceleration, to_noise = (turn, turn) if order else (np.square(turn), ones)
    columns = [spectrum_of_pieces.density, to_acceleration[:, None] * spectrum_of_pieces.density]
    columns.append(np.stack([to_noise, ones, np.square(turn)], axis=1))
    sums = spectrum_of_pieces.frequency[0] * product(share, np.concatenate(columns, axis=1))
    energy, force, (noise, width, gain) = sums[:, :m], sums[:, m : 2 * m], sums[:, 2 * m :].T
    density = energy / noise[:, None]
    return Bands(cutoff, density, force, width, gain, order, spectrum_of_pieces.span)


class Bands(NamedTuple):
    """Signals split at k frequencies.

    Attributes:
        cutoff: Lower ends of the bands [Hz], shape (k,).
        density: P in each [rad^2/Hz or m^2/Hz], shape (k, m).
        acceleration: Mean square of the accelerations [rad^2/s^4 or m^2/s^4], shape (k, m).
        width: Of each band [Hz], shape (k,).
        gain: Acceleration in each from noise of density 1 [1/s^4 Hz], shape (k,).
        order: 0 of positions, 1 of velocities.
        span: Of a piece that they are from [s].
    """

    cutoff: Array
    density: Array
    acceleration: Array
    width: Array
    gain: Array
    order: int
    span: float


def _frequencies(times: Array) -> Array:
    """From a quarter of a period in the recording to where smoothing ends."""
    lowest, highest = 0.25 / (times[-1] - times[0]), HIGHEST * rate_of(times)
    count = max(int(np.ceil(np.log(highest / lowest) / np.log(_RATIO))), 1)
    frequencies: Array = lowest * _RATIO ** np.arange(count)
    return frequencies


def _column(pieces: Sequence[tuple[Array, Array]], k: int) -> Array:
    """Return a signal of all pieces; few signals are needed completely."""
    return np.concatenate([values[:, k] for _, values in pieces])


def _best(bands: Bands, column: int, signal: Callable[[], Array]) -> float:
    """Return the cutoff frequency of a signal, which is a column of the bands."""
    density, acceleration = bands.density[:, column], bands.acceleration[:, column]
    first = _first_of_noise(bands, density, signal)
    if first is None:
        return np.inf
    at_first = density[first] * (2.0 * np.pi * bands.cutoff[first]) ** (2 * bands.order)
    if at_first * bands.cutoff[-1] <= (_EXACT * np.abs(signal()).max()) ** 2:
        return np.inf
    noise = np.minimum(density, density[first])
    noise[:first] = density[first]
    passed = noise * bands.gain
    lost = np.maximum(acceleration - passed, 0.0)
    lost[first:] = 0.0
    error = np.cumsum(lost[::-1])[::-1] + np.r_[0.0, np.cumsum(passed)[:-1]]
    error += _lost_at_ends(bands, lost)
    best = bands.cutoff[np.flatnonzero(error <= _GENEROUS * error.min())[-1]]
    return max(float(best), LOWEST)


def _first_of_noise(bands: Bands, density: Array, signal: Callable[[], Array]) -> int | None:
    """Return the first band that is noise and beyond which is only noise, or None.

    Args:
        density: Of the signal in them.
        signal: Gives its samples.
    """
    count, variance = len(density), None
    above = np.cumsum((density * bands.width)[::-1])[::-1]
    rising = density * bands.cutoff**_STEEPEST
    density = np.maximum(density, np.finfo(np.float64).tiny)
    highest = np.maximum.accumulate(density[::-1])[::-1]
    comes_up = np.maximum.accumulate((highest / density)[::-1])[::-1]
    lowest = np.minimum.accumulate(density[::-1])[::-1]
    for k in range(count - 1):
        if not _is_flat(rising[k : k + 1 + _BANDS]):
            continue
        is_noise = comes_up[k] <= _HUMP
        is_white = count - k >= _WHITE and highest[k] <= _HUMP * lowest[k]
        if is_noise and (is_white or above[k] <= _SHARE * above[0]):
            return k
        if variance is None:  # of rounding; sorts the samples, which few signals need
            variance = 0.0 if bands.order else _step(signal()) ** 2 / 12.0
        if above[k] <= 2.0 * variance:
            return k
    return None


def _is_flat(rising: NDArray[np.float64]) -> bool:
    return bool((rising[1:] > rising[0]).all() and rising[-1] > _RISE * rising[0])


def _step(signal: Array) -> float:
    """Return the resolution of a signal of multiples of a step; 0 for other signals."""
    steps = np.diff(np.sort(signal))
    steps = steps[steps > 1e-9 * np.ptp(signal)]
    few = len(steps) < 8
    if len(steps) == 0 or (few and len(signal) < _HELD * (len(steps) + 1)):
        return 0.0
    step = float(steps.min())
    for some in (steps[:_FIRST], steps[_FIRST:]):  # few steps usually suffice
        multiples = some / step
        if np.abs(multiples - np.rint(multiples)).max(initial=0.0) >= 0.02:
            return 0.0
    return step


def _lost_at_ends(bands: Bands, lost: Array) -> Array:
    """Return the mean square of the accelerations that a cutoff loses near both ends, shape (k,).

    There a smoothing spline has no derivatives from the fourth on. What a signal with the fourth
    derivative y4 loses decays within a period; the integral of its square is
    factor * y4^2 / (2 pi f)^(5 + 2 order).
    """
    order, turn = bands.order, 2.0 * np.pi * bands.cutoff
    y4 = lost @ turn ** (4 + 2 * order)  # mean square
    both: Array = 2.0 * _AT_END[order] * y4 / turn ** (5 + 2 * order) / bands.span
    return both


def _renewals(signal: Array) -> float:
    """Return how often a changing signal has a new value per sample; inf if every sample is new.

    A joint that rests in between does not repeat samples: most runs of equal samples count, not
    most samples.
    """
    changes = np.flatnonzero(np.diff(signal))
    if len(changes) == len(signal) - 1:
        return np.inf
    runs = np.diff(changes)
    usual = float(np.median(runs)) if len(runs) else 1.0
    return 1.0 / usual if usual > 1.0 else np.inf


def cutoff_lines(cutoff: Array, names: Sequence[str], chosen: bool, samples: int) -> Iterator[str]:
    """Yield remarks on the low-pass filter of each joint.

    Args:
        cutoff: That of the result of `zero_phase`.
        names: Of the joints.
        chosen: Whether the recording asked for it, not the user.
        samples: Number of them.
    """
    source = "from the noise of the recording" if chosen else "as given"
    smoothed = np.flatnonzero(np.isfinite(cutoff))
    if smoothed.size:
        low, high = (pick(smoothed, key=cutoff.__getitem__) for pick in (min, max))
        span = f"{cutoff[low]:.3g} Hz"
        if cutoff[high] > cutoff[low]:
            span += f" ({names[low]}) to {cutoff[high]:.3g} Hz ({names[high]})"
        yield f"zero-phase derivatives: low-pass of half power at {span}, {source}"
    lowest = [name for name, f in zip(names, cutoff, strict=True) if chosen and f <= LOWEST]
    if lowest:
        yield (
            f"warning: zero-phase derivatives: {LOWEST:g} Hz is the lowest cut-off that is chosen "
            f"({', '.join(lowest)}); where a recording is short or noisy, motion above it is "
            "lost: compare with --cutoff"
        )
    sharp = [name for name, f in zip(names, cutoff, strict=True) if np.isinf(f)]
    if sharp:
        why = "no noise is found" if chosen else "the sampling rate is too low for that cut-off"
        if chosen and samples < FEWEST_TELLING:
            why = f"{samples} samples are too few to tell noise from motion (--cutoff smooths)"
        elif chosen and samples < _FEW:
            why = f"no noise is found in {samples} samples, few to see it in (--cutoff smooths)"
        warning = "warning: " * (chosen and samples < _FEW)
        yield f"{warning}zero-phase derivatives: not smoothed, since {why}: {', '.join(sharp)}"
