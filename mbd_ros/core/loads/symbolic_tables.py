"""Tables in time where the time is a symbol."""

from typing import Any

import numpy as np

from mbd_ros.core.state import Array


def between_samples(t: Any, times: Array, values: Array) -> Array:
    """Straight lines between the rows of a table at a time that is a symbol; zero outside.

    Args:
        t: The time [s].
        times: [s], strictly increasing, shape (m,).
        values: One row a time, shape (m, n).
    """
    slopes = np.diff(values, axis=0) / np.diff(times)[:, None]
    pieces = np.column_stack((times[:-1], values[:-1], slopes))
    ends = [*times[:-1].tolist(), np.nextafter(times[-1], np.inf)]
    nothing = np.zeros((1, pieces.shape[1]))
    begin, *row = t.piecewise(ends, np.concatenate((nothing, pieces, nothing)))
    n = values.shape[1]
    at = [value + (t - begin) * slope for value, slope in zip(row[:n], row[n:], strict=True)]
    return np.array(at, dtype=object)
