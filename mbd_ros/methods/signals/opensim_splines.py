"""Derivatives as OpenSim's inverse dynamics takes them: its low-pass and quintic splines."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError

_DEGREE = 5
_FEWEST = _DEGREE + 1  # samples
_HIGHEST, _INSTEAD = 0.5, 0.49  # cut-off per sampling rate beyond which OpenSim takes the other
_KEPT = 3  # first samples, which a pass hands on as they are


class Splined(NamedTuple):
    """A motion and its derivatives.

    Attributes:
        stamps: Times [ns], shape (n,); those of the samples, unless they had to be resampled.
        position: [rad or m], shape (n, m).
        velocity: [rad/s or m/s], same shape.
        acceleration: [rad/s^2 or m/s^2], same shape.
    """

    stamps: NDArray[np.int64]
    position: Array
    velocity: Array
    acceleration: Array


def opensim_splines(
    stamps: NDArray[np.int64], position: Array, cutoff: float | None = None
) -> Splined:
    """Quintic splines through samples behind a low-pass, as `InverseDynamicsTool` has them.

    With a cut-off: half the samples are put before and behind by odd reflection, 2 x_0 - x_i;
    where steps differ all is resampled at the smallest one; a third-order Butterworth filter
    passes forwards and backwards. Splines have no third and fourth derivative at both ends.

    Args:
        stamps: Sample times [ns], increasing, shape (n,).
        position: [rad or m], shape (n, m).
        cutoff: Of one pass of the filter [Hz]; two passes have less. None: no filter.

    Raises:
        DataError: Too few samples, or a cut-off out of its range.

    Source: conventions of OpenSim 4.6, `Storage.pad`, `Storage.lowpassIIR`, `GCVSplineSet`.
    """
    if len(stamps) < _FEWEST:
        raise DataError(f"{len(stamps)} samples, quintic splines need {_FEWEST}")
    if cutoff is None:
        times = (stamps - stamps[0]) * NANOSECOND
        return Splined(stamps, *_derivatives(times, position, times))
    if not (np.isfinite(cutoff) and cutoff > 0):
        raise DataError(f"cutoff {cutoff} Hz must be finite and > 0")
    pad = len(stamps) // 2
    padded, values = _reflected(stamps[:, None], pad)[:, 0], _reflected(position, pad)
    steps = np.diff(padded)
    step = int(steps.min())
    if (steps != step).any():
        even = np.arange(padded[0], padded[-1] + 1, step)
        values = _spline(_seconds(padded, padded), values)(_seconds(even, padded))
        padded = even
    forwards = _butterworth(values, step * NANOSECOND, cutoff)
    passed = _butterworth(forwards[::-1], step * NANOSECOND, cutoff)[::-1]
    first, last = np.searchsorted(padded, stamps[[0, -1]], side="right") - 1
    inside = slice(int(first), int(last) + 1)
    times = _seconds(padded, padded)
    return Splined(padded[inside], *_derivatives(times, passed, times[inside]))


def _seconds(stamps: NDArray[np.int64], whole: NDArray[np.int64]) -> Array:
    """Times since the first of the whole [s]."""
    return (stamps - whole[0]) * NANOSECOND


def _reflected(values: NDArray[Any], pad: int) -> NDArray[Any]:
    """Values between their odd reflections about the first and the last one."""
    before = 2 * values[0] - values[pad:0:-1]
    behind = 2 * values[-1] - values[-2 : -2 - pad : -1]
    return np.concatenate([before, values, behind])


def _butterworth(values: Array, step: float, cutoff: float) -> Array:
    """One pass of a third-order Butterworth filter by the bilinear transform, tan prewarp.

    The first samples of a pass are its input.
    """
    from scipy.signal import lfilter

    rate = 1.0 / step
    w = np.tan(np.pi * (cutoff if cutoff <= _HIGHEST * rate else _INSTEAD * rate) * step)
    divisor = (w + 1) * (w**2 + w + 1)
    b = w**3 * np.array([1.0, 3.0, 3.0, 1.0]) / divisor
    a = [
        1.0,
        (3 * w**3 + 2 * w**2 - 2 * w - 3) / divisor,
        (3 * w**3 - 2 * w**2 - 2 * w + 3) / divisor,
        (w - 1) * (w**2 - w + 1) / divisor,
    ]
    state = _state_after(values[:_KEPT], b, np.array(a))
    passed, _ = lfilter(b, a, values[_KEPT:], axis=0, zi=state)
    return np.concatenate([values[:_KEPT], passed])


def _state_after(values: Array, b: Array, a: Array) -> Array:
    """State of the filter behind samples that are both its input and its output, (3, m)."""
    state = np.zeros((_KEPT, values.shape[1]))
    for k in range(_KEPT):
        for i in range(k, _KEPT):
            state[k] += (b[i + 1] - a[i + 1]) * values[_KEPT - 1 - i + k]
    return state


def _spline(times: Array, values: Array) -> Any:
    from scipy.interpolate import make_interp_spline

    nothing = np.zeros(values.shape[1])
    ends = [(3, nothing), (4, nothing)]
    return make_interp_spline(times, values, k=_DEGREE, bc_type=(ends, ends), axis=0)


def _derivatives(times: Array, values: Array, wanted: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of the spline."""
    spline = _spline(times, values)
    return spline(wanted), spline(wanted, nu=1), spline(wanted, nu=2)
