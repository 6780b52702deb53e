"""A motion as it was recorded: joints, markers, plans."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError, ModelError
from mbd_ros.files.formats import read_result
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table, motion_stamps
from mbd_ros.methods.control.tracking_plan import TrackingPlan

# ---- recording --------------------------------------------------------------------------------
# A motion as it was recorded.


NO_BODIES: Mapping[str, str] = MappingProxyType({})


class Recording(NamedTuple):
    """A motion and what was left out of it.

    Attributes:
        motion: The samples that can be used.
        dropped: Messages left out, counted by reason.
        by_log_time: Header stamps were zero, so stamps are the log times of the bag.
        assumed: Required joints that a storage of a laboratory lacks, at the position assumed.
        unused: Labels of such a storage that are of no joint asked for; None of other sources.
        remarks: What is odd about such a storage, for people.
        of_laboratory: Whether it is such a storage, or a motion found from markers: a motion of
            these may have positions alone.
    """

    motion: Motion
    dropped: Counter[str]
    by_log_time: bool = False
    assumed: tuple[str, ...] = ()
    unused: tuple[str, ...] | None = None
    remarks: tuple[str, ...] = ()
    of_laboratory: bool = False


# ---- markers ----------------------------------------------------------------------------------
# Markers of a recording: labelled points in the ground, from .trc, .c3d or a result.


GROUND = "ground"  # frame of markers and plates
MARKERS, RATE = "markers", "rate"  # metadata: labels, and frames a second [Hz]
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


# ---- plans ------------------------------------------------------------------------------------
# Plans to follow: a table `plan` of a result, in one file with the motion itself.


PLAN = "plan"  # table, and entry of the metadata
_FIELDS = ("position", "velocity", "effort", "gain", "cost")


def plan_table(plan: TrackingPlan) -> Table:
    """Columns of a plan, a row a sample."""
    arrays = plan.q, plan.v, plan.u, plan.gain, plan.cost
    columns = [Column(name, values) for name, values in zip(_FIELDS, arrays, strict=True)]
    return Table([Column(TIME, plan.times, "s"), *columns])


def plan_words(plan: TrackingPlan) -> dict[str, object]:
    """What metadata say of a plan: names in the order of its arrays, and the tube."""
    return {"joints": list(plan.joints), "inputs": list(plan.inputs), "level": plan.level}


def read_plan(path: str | Path | Result) -> TrackingPlan:
    """The plan of a file, or of a result.

    Raises:
        DataError: It cannot be read, or holds none.
    """
    where = "plan" if isinstance(path, Result) else str(path)
    result = path if isinstance(path, Result) else read_result(path)
    words, table = result.metadata.get(PLAN), result.tables.get(PLAN)
    if not isinstance(words, dict) or table is None:
        raise DataError(f"{where}: holds no plan; `mbd-ros follow` writes one")
    try:
        joints, inputs = (tuple(map(str, words[key])) for key in ("joints", "inputs"))
        arrays = [np.asarray(table[name], dtype=np.float64) for name in (TIME, *_FIELDS)]
        return TrackingPlan(joints, inputs, *arrays, float(words["level"]))
    except (KeyError, TypeError, ValueError, ModelError) as error:
        raise DataError(f"{where}: holds no plan: {error}") from error
