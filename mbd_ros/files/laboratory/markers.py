"""Markers of a recording: labelled points in the ground, from .trc, .c3d or a result."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.table import MAIN, Result, motion_stamps, read_result

GROUND = "ground"  # frame of markers and plates
MARKERS, RATE = "markers", "rate"  # metadata: labels, and frames a second [Hz]
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # of a unit of files
SCREEN = "screen"  # metadata: axes to the right and upwards on a screen, as +X, +Z


class MarkerSamples(NamedTuple):
    """Positions of markers, one row a frame.

    Attributes:
        labels: Names of the markers, as the file has them.
        stamps: Times [ns], strictly increasing, shape (n,).
        position: In the ground [m], shape (n, len(labels), 3); NaN where a marker was not seen.
    """

    labels: tuple[str, ...]
    stamps: NDArray[np.int64]
    position: Array


def read_markers(source: str | Path | Result) -> MarkerSamples:
    """Markers of a file or result; without a list of labels all columns of points count.

    Raises:
        DataError: A file that cannot be read, or no point in it.
    """
    where = "the result" if isinstance(source, Result) else str(source)
    result = source if isinstance(source, Result) else read_result(source)
    table = result[MAIN]
    points = [column.name for column in table.columns if column.values.shape[1:] == (3,)]
    labels = tuple(result.metadata.get(MARKERS, points))
    if not labels or not set(labels) <= set(points):
        raise DataError(f"{where}: no markers: no columns of three numbers a row")
    position = np.stack([table[label] for label in labels], axis=1).astype(np.float64)
    return MarkerSamples(labels, motion_stamps(table, where), position)
