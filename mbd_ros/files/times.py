"""Times of tables: seconds for people, nanoseconds where floats cannot tell them."""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Table

TIME, STAMP = "time", "stamp"
RUN = "run"  # in a table of many runs, its first column
_HEADER = 1  # lines above the rows of a table
TIME_LIMIT = 9e9  # s: int64 nanoseconds end at 9.22e9 s


def time_columns(stamps: NDArray[np.int64]) -> list[Column]:
    """Column `time` [s]; also `stamp` [ns] where seconds as floats do not give the stamps back.

    Args:
        stamps: [ns], shape (n,).
    """
    time = stamps / 1e9
    columns = [Column(TIME, time, "s")]
    if (rounded(time) != stamps).any():
        columns.append(Column(STAMP, stamps, "ns"))
    return columns


def stamps_of(table: Table) -> NDArray[np.int64]:
    """Stamps [ns] of the rows of a table, shape (n,)."""
    if STAMP in table and table[STAMP].dtype.kind == "i":
        return table[STAMP].astype(np.int64)
    return rounded(table[TIME])


def rounded(time: Array) -> NDArray[np.int64]:
    """Times [s] in whole nanoseconds."""
    return np.round(time / NANOSECOND).astype(np.int64)


def motion_stamps(table: Table, where: str) -> NDArray[np.int64]:
    """Stamps [ns] of a table that is read as a motion, shape (n,).

    Args:
        table: With column `time` or `stamp`.
        where: File, for the messages.

    Raises:
        DataError: Times outside of int64 nanoseconds, or equal when rounded to them.
    """
    if STAMP in table and table[STAMP].dtype.kind == "i":
        stamps = table[STAMP].astype(np.int64)
    else:
        time = table[TIME]
        if not np.abs(time).max(initial=0.0) <= TIME_LIMIT:
            raise DataError(f"{where}: column time: beyond {TIME_LIMIT:g} s")
        stamps = np.round(time * 1e9).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        line = np.flatnonzero(np.diff(stamps) <= 0)[0] + _HEADER + 2
        raise DataError(f"{where}: line {line}, column time: less than 1 ns after the last")
    return stamps
