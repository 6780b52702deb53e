"""Instants of a history that matter: peaks of its loads, and those that were chosen."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.features.loads.history import History

CHOSEN = "chosen"
_NOTHING = 1.0e-9  # of the largest load: a peak below it is rounding


class Instant(NamedTuple):
    """A sample that is marked.

    Attributes:
        row: Of the history.
        name: `<load>.force` or `<load>.torque` of a peak, or `chosen`.
        value: Of the peak [N or N·m], 0 where it was chosen.
    """

    row: int
    name: str
    value: float


def instants_of(history: History, chosen: Sequence[float]) -> list[Instant]:
    """Peaks of force and moment of every load, and chosen instants, in the order of time.

    Args:
        history: The loads.
        chosen: Times [s]; the nearest sample is taken.

    Raises:
        DataError: A time outside of the history.
    """
    found = [Instant(_row(history, time), CHOSEN, 0.0) for time in chosen]
    for quantity, values in (("force", history.force), ("torque", history.moment)):
        sizes: Array = np.linalg.norm(values, axis=2)
        least = _NOTHING * sizes.max(initial=0.0)
        for slot, size in zip(history.slots, sizes.T, strict=True):
            row = int(size.argmax())
            if size[row] > least:
                found.append(Instant(row, f"{slot.name}.{quantity}", float(size[row])))
    return sorted(found, key=lambda each: (each.row, each.name))


def _row(history: History, time: float) -> int:
    times = history.stamps * NANOSECOND
    if not times[0] - 1e-9 <= time <= times[-1] + 1e-9:
        raise DataError(
            f"--at {time:g}: outside of the motion, accepted: {times[0]:.9g} to {times[-1]:.9g} s"
        )
    return int(np.abs(times - time).argmin())
