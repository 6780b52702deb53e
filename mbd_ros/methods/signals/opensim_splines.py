"""Derivatives by the low-pass and quintic splines of OpenSim's inverse dynamics."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError

_DEGREE = 5
_FEWEST = _DEGREE + 1  # samples
_HIGHEST, _INSTEAD = 0.5, 0.49  # relative cut-off that OpenSim replaces by the second one
_UNFILTERED = 3  # first samples of a pass


class Splined(NamedTuple):
    """A motion and its derivatives.

    Attributes:
        stamps: Times [ns], shape (n,); those of the samples, unless they were resampled.
        position: Positions [rad or m], shape (n, m).
        velocity: Velocities [rad/s or m/s], shape (n, m).
        acceleration: Accelerations [rad/s^2 or m/s^2], shape (n, m).
    """

    stamps: NDArray[np.int64]
    position: Array
    velocity: Array
    acceleration: Array


def opensim_splines(
    stamps: NDArray[np.int64], position: Array, cutoff: float | None = None
) -> Splined:
    """Differentiate samples by low-pass and quintic splines like OpenSim's `InverseDynamicsTool`.

    With a cut-off, half the samples are padded at both ends by odd reflection, 2 x_0 - x_i;
    samples with varying steps are resampled at the smallest step; a third-order Butterworth filter
    runs forwards and backwards. The third and fourth derivatives of splines are zero at both ends.

    Args:
        stamps: Sample times [ns], increasing, shape (n,).
        position: Positions [rad or m], shape (n, m).
        cutoff: Cut-off of one pass of the filter [Hz]; that of both is lower. None for no filter.

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


def _seconds(stamps: NDArray[np.int64], recording: NDArray[np.int64]) -> Array:
    """Return times since the begin of a recording [s]."""
    return (stamps - recording[0]) * NANOSECOND


def _reflected(values: NDArray[Any], pad: int) -> NDArray[Any]:
    """Pad values by odd reflection about the first and the last one."""
    before = 2 * values[0] - values[pad:0:-1]
    behind = 2 * values[-1] - values[-2 : -2 - pad : -1]
    return np.concatenate([before, values, behind])


def _butterworth(values: Array, step: float, cutoff: float) -> Array:
    """Run a third-order Butterworth filter (bilinear transform with prewarping) once.

    The first samples of a pass are not filtered.
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
    state = _state_after(values[:_UNFILTERED], b, np.array(a))
    passed, _ = lfilter(b, a, values[_UNFILTERED:], axis=0, zi=state)
    return np.concatenate([values[:_UNFILTERED], passed])


def _state_after(values: Array, b: Array, a: Array) -> Array:
    """Return the filter state after samples that are both input and output, shape (3, m)."""
    state = np.zeros((_UNFILTERED, values.shape[1]))
    for k in range(_UNFILTERED):
        for i in range(k, _UNFILTERED):
            state[k] += (b[i + 1] - a[i + 1]) * values[_UNFILTERED - 1 - i + k]
    return state


def _spline(times: Array, values: Array) -> Any:
    from scipy.interpolate import make_interp_spline

    nothing = np.zeros(values.shape[1])
    ends = [(3, nothing), (4, nothing)]
    return make_interp_spline(times, values, k=_DEGREE, bc_type=(ends, ends), axis=0)


def _derivatives(times: Array, values: Array, wanted: Array) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of the spline."""
    spline = _spline(times, values)
    return spline(wanted), spline(wanted, nu=1), spline(wanted, nu=2)
