"""Velocity and acceleration of a whole recording by fits to a few samples around each."""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError


def local_polynomials(
    stamps: NDArray[np.int64],
    position: Array,
    velocity: Array | None = None,
    *,
    half_width: int,
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
