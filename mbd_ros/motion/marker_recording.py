"""Recorded markers: labels, times and places, from any table of markers."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag, read_result
from mbd_ros.files.markers import SCREEN
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.files.times import TIME
from mbd_ros.motion.recordings import Source, name_of

UNITS = {"m": 1.0, "mm": 1.0e-3, "cm": 1.0e-2}
_AXES = ("x", "y", "z")
_ENDINGS = (".{}", ".position_{}", ".position.{}", "_{}")  # of the columns of a marker
_FAR = 50.0  # m from one marker to another of a frame: no person and no laboratory has that


class Capture(NamedTuple):
    """Recorded markers.

    Attributes:
        where: File, for messages.
        labels: Of the markers.
        times: [s], increasing, shape (N,).
        places: In the world [m], NaN where one was not seen, shape (N, n, 3).
        screen: Recorded axes to the right and upwards on a screen, as `+X`, `+Z`; empty where the
            recording does not say them.
    """

    where: str
    labels: tuple[str, ...]
    times: Array
    places: Array
    screen: tuple[str, ...] = ()

    def between(self, begin: float | None, end: float | None) -> "Capture":
        """The frames of a range of times.

        Raises:
            DataError: There is none in it.
        """
        low, high = (-np.inf if begin is None else begin), (np.inf if end is None else end)
        inside = (self.times >= low - 1e-9) & (self.times <= high + 1e-9)
        if not inside.any():
            raise DataError(
                f"{self.where}: no frame from {low:g} to {high:g} s; there are frames from "
                f"{self.times[0]:g} to {self.times[-1]:g} s"
            )
        return self._replace(times=self.times[inside], places=self.places[inside])


def read_capture(source: Source, unit: str | None = None) -> Capture:
    """Markers of a file or result.

    Columns are `<label>.x`, `.y`, `.z`, or `<label>.position_x` as simulations write them, or
    `<label>` with three numbers a row.

    Args:
        source: A result, or a file of one.
        unit: Of the places: m, mm or cm; None for that of the columns, m where they have none.

    Raises:
        DataError: A file that cannot be read, no markers in it, or places that are no metres.
    """
    where = name_of(source)
    if unit is not None and unit not in UNITS:
        raise DataError(f"{where}: unknown unit '{unit}', accepted: {', '.join(UNITS)}")
    if not isinstance(source, Result):
        if is_bag(source):
            raise DataError(f"{where}: a bag holds no markers here; accepted: tables of markers")
        source = read_result(source)
    if MAIN not in source or TIME not in source[MAIN]:
        raise DataError(f"{where}: no table {MAIN} with a column {TIME}")
    table = source[MAIN]
    found = _markers(table)
    if not found:
        raise DataError(
            f"{where}: no markers; accepted are columns <label>.x, .y and .z, there are: "
            f"{', '.join(list(table)[:8])}"
        )
    places = np.stack([np.asarray(p, dtype=np.float64) for p, _ in found.values()], axis=1)
    told = next((told for _, told in found.values() if told), "")
    if unit and told and unit != told:
        raise DataError(f"{where}: markers are in {told} there, not in {unit}: leave the unit out")
    scales = [UNITS[unit or told or "m"] for _, told in found.values()]
    places = places * np.array(scales)[:, None]
    times = np.asarray(table[TIME], dtype=np.float64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) <= 0.0).any():
        raise DataError(f"{where}: column {TIME}: must be finite and increase from row to row")
    _refuse_far(where, tuple(found), places, times)
    return Capture(where, tuple(found), times, places, tuple(source.metadata.get(SCREEN, ())))


def _markers(table: Table) -> dict[str, tuple[Array, str]]:
    """Label -> places and their unit, in the order of the columns."""
    found: dict[str, tuple[Array, str]] = {}
    for column in table.columns:
        if column.values.ndim == 2 and column.values.shape[1] == len(_AXES):
            found[column.name] = column.values, _unit(column.unit)
            continue
        for ending in _ENDINGS:
            first = ending.format(_AXES[0])
            label = column.name.removesuffix(first)
            names = [label + ending.format(axis) for axis in _AXES]
            if column.name.endswith(first) and label and all(name in table for name in names):
                if all(table[name].ndim == 1 for name in names):
                    places = np.column_stack([table[name] for name in names])
                    found.setdefault(label, (places, _unit(column.unit)))
                break
    return found


def _unit(told: str) -> str:
    return told if told in UNITS else ""


def _refuse_far(where: str, labels: Sequence[str], places: Array, times: Array) -> None:
    """Refuse places that are millimetres."""
    with np.errstate(invalid="ignore"):
        apart = np.nanmax(places, axis=1, initial=-np.inf, where=np.isfinite(places))
        apart = apart - np.nanmin(places, axis=1, initial=np.inf, where=np.isfinite(places))
    apart = np.where(np.isfinite(apart), apart, 0.0).max(axis=1)
    at = int(np.argmax(np.median(apart) if len(apart) == 0 else apart))
    if np.median(apart) > _FAR:
        raise DataError(
            f"{where}: markers are {apart[at]:.4g} m apart at t = {times[at]:.9g} s, which looks "
            f"like millimetres ({len(labels)} markers): say --unit mm"
        )
