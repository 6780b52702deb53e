"""Activations that were measured, at the frames of a motion."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.files.formats import read_result
from mbd_ros.files.table import MAIN
from mbd_ros.files.times import motion_stamps

_QUANTITY = "activation"


def measured_activations(
    path: Path | None, muscles: Sequence[Muscle], stamps: NDArray[np.int64]
) -> Array | None:
    """Columns `<muscle>.activation`, linear between their rows, NaN for a muscle without one.

    Args:
        path: A table; None where nothing was measured.
        muscles: The muscles.
        stamps: Of the frames [ns], shape (frames,).

    Raises:
        DataError: A file that cannot be read, has none of the muscles, values outside 0 .. 1, or
            does not cover the motion.
    """
    if path is None:
        return None
    table = read_result(path)[MAIN]
    known = [i for i, muscle in enumerate(muscles) if f"{muscle.name}.{_QUANTITY}" in table]
    if not known:
        names = ", ".join(f"{muscle.name}.{_QUANTITY}" for muscle in muscles)
        raise DataError(f"{path}: no column of a muscle, accepted: {names}")
    at = motion_stamps(table, str(path))
    if not (len(at) and at[0] <= stamps[0] and stamps[-1] <= at[-1]):
        covered = " to ".join(f"{t * NANOSECOND:.6g}" for t in at[[0, -1]]) if len(at) else "no"
        asked = " to ".join(f"{t * NANOSECOND:.6g}" for t in stamps[[0, -1]])
        raise DataError(f"{path}: activations at {covered} s do not cover the motion at {asked} s")
    found = np.full((len(stamps), len(muscles)), np.nan)
    for i in known:
        values = table[f"{muscles[i].name}.{_QUANTITY}"]
        outside = np.flatnonzero(~((values >= 0.0) & (values <= 1.0)))
        if len(outside):
            row = int(outside[0])
            raise DataError(
                f"{path}: {muscles[i].name}.{_QUANTITY} at {at[row] * NANOSECOND:.6g} s is "
                f"{values[row]:.6g}, accepted: 0 .. 1"
            )
        found[:, i] = np.interp((stamps - at[0]) * NANOSECOND, (at - at[0]) * NANOSECOND, values)
    return found
