"""Numbers in CSV files, plain or gzip: strict when read, whole or not at all when written."""

import itertools
import math
import re
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.errors import DataError
from mbd_ros.files.table import MAIN, RUN, STAMP, TIME, Column, Result, Table
from mbd_ros.files.text_file import (
    MAX_CELLS,
    MAX_COLUMNS,
    Lines,
    reading,
    repeated_among,
    replacing,
)

NUMBER = re.compile(rb"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
# Besides digits only the letters of "nan" pass: float() would take inf, 1_000 and foreign digits.
CHARACTERS = b"0123456789+-.eE,\nnaN"
BLOCK, BLOCK_CELLS = 4096, 1_000_000  # lines, and numbers, that are taken at once


class Csv:
    """One table of numbers under a header line, `time` first; no units, frames or metadata."""

    content = "one number a row"
    one_table = True

    def holds(self, column: Column) -> bool:
        """Whether it is a finite number, or nan, a row."""
        values = column.values
        if values.ndim != 1 or values.dtype.kind not in "fiub":
            return False
        return values.dtype.kind != "f" or not np.isinf(values).any()

    def read(self, path: Path, nan_allowed: Callable[[str], bool] = lambda column: True) -> Result:
        """Read a table; nan is accepted where `nan_allowed` does not refuse it by column."""
        read = read_table(path, nan_allowed)
        pairs = zip(read.columns, read.values.T, strict=True)
        return Result({MAIN: Table(Column(name, values) for name, values in pairs)})

    def write(self, path: Path, result: Result) -> None:
        """Write a table; its `stamp`, the time in nanoseconds, is left out.

        Raises:
            DataError: Too many columns, or a place that cannot be written to.
        """
        (table,) = result.tables.values()
        columns = {name: values for name, values in table.items() if name != STAMP}
        if len(columns) > MAX_COLUMNS:
            raise DataError(
                f"{path}: {len(columns)} columns, .csv holds {MAX_COLUMNS}; .npz and .parquet "
                "hold more"
            )
        write_table(path, list(columns), np.column_stack(list(columns.values())))


class Numbers(NamedTuple):
    """One CSV file.

    Attributes:
        path: Where it was read from.
        columns: Names of the header line; the first is `time`.
        values: One row a line, shape (n, len(columns)); n >= 1, time strictly increasing.
    """

    path: Path
    columns: tuple[str, ...]
    values: NDArray[np.float64]


def read_table(
    path: str | Path,
    nan_allowed: Callable[[str], bool] | None = None,
    *,
    has_times: bool = True,
) -> Numbers:
    """Read a table whose cells are all plain finite numbers, block by block.

    Args:
        path: A .csv file, or .csv.gz.
        nan_allowed: Says by name which columns may hold `nan`; none without it.
        has_times: Whether the first column is the time, or the run of many that follow one
            another.

    Raises:
        DataError: File, line and column of what is not acceptable, or what is too large.
    """
    path = Path(path)
    with reading(path) as file:
        lines = Lines(path, file)
        columns = _columns(path, next(lines, b""), has_times)
        has_times = columns[0] == TIME
        may_lack = np.array([bool(nan_allowed and nan_allowed(name)) for name in columns])
        blocks: list[NDArray[np.float64]] = []
        count, last = 0, -math.inf
        rows = max(1, min(BLOCK, BLOCK_CELLS // len(columns)))
        while block := list(itertools.islice(lines, rows)):
            values = _values(path, columns, block, count + 2, may_lack)
            if has_times:
                _check_times(path, np.concatenate(([last], values[:, 0])), count + 1)
            blocks.append(values)
            count, last = count + len(block), float(values[-1, 0])
            if count * len(columns) > MAX_CELLS:
                raise DataError(f"{path}: more than {MAX_CELLS} numbers are not accepted")
    if not blocks:
        raise DataError(f"{path}: has a header and no data")
    return Numbers(path, columns, np.concatenate(blocks))


def _columns(path: Path, header: bytes, has_times: bool) -> tuple[str, ...]:
    begin = " that begins with time" if has_times else ""
    if not header.strip():
        raise DataError(f"{path}: is empty, expected a header line{begin}")
    try:
        columns = header.decode("utf-8-sig").split(",")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: line 1 is not text, expected a CSV header") from error
    if has_times and columns[0] not in (TIME, RUN):
        raise DataError(f"{path}: line 1: first column is {columns[0][:40]!r}, expected 'time'")
    if len(columns) > MAX_COLUMNS:
        raise DataError(f"{path}: {len(columns)} columns, accepted are {MAX_COLUMNS}")
    if "" in columns:
        raise DataError(f"{path}: line 1: column {columns.index('') + 1} has no name")
    if repeated := repeated_among(columns):
        raise DataError(f"{path}: line 1 repeats column {', '.join(repeated)}")
    return tuple(columns)


def _check_times(path: Path, times: NDArray[np.float64], first: int) -> None:
    """Refuse times that do not increase; `first` is the line of the first of them."""
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        before, time = times[late[0] : late[0] + 2].tolist()
        raise DataError(
            f"{path}: line {first + late[0] + 1}, column time: {time!r} is not after {before!r} of"
            " the line before, time must strictly increase"
        )


def _values(
    path: Path,
    columns: tuple[str, ...],
    lines: list[bytes],
    first: int,
    may_lack: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Cells of lines from number `first` on; only if something is wrong looked at one by one."""
    width, cells = len(columns), array("d")
    clean = not any(line.translate(None, CHARACTERS) for line in lines)
    try:
        for number, line in enumerate(lines, first):
            row = line.split(b",")
            if len(row) != width:
                raise DataError(f"{path}: line {number} has {len(row)} fields, expected {width}")
            if clean:
                cells.extend(map(float, row))
    except ValueError:
        clean = False
    values = np.frombuffer(cells).reshape(-1, width) if clean else np.full((1, width), np.inf)
    if not (np.isfinite(values) | (np.isnan(values) & may_lack)).all():
        raise _first_bad_cell(path, columns, lines, first, may_lack)
    return values


def _first_bad_cell(
    path: Path,
    columns: tuple[str, ...],
    lines: list[bytes],
    first: int,
    may_lack: NDArray[np.bool_],
) -> DataError:
    for number, line in enumerate(lines, first):
        for column, cell, lacks in zip(columns, line.split(b","), may_lack, strict=True):
            missing = lacks and cell in (b"nan", b"NaN")
            if not missing and not (NUMBER.fullmatch(cell) and np.isfinite(float(cell))):
                shown = cell[:40].decode("utf-8", "backslashreplace")
                return DataError(
                    f"{path}: line {number}, column {column}: {shown!r} is not a plain finite"
                    " number"
                )
    return DataError(f"{path}: holds a cell that is not a plain finite number")


def write_table(path: str | Path, columns: Sequence[str], values: NDArray[np.float64]) -> None:
    """Write a table so that reading it gives the same bits; equal tables give equal files.

    Args:
        path: The file, gzip where it ends in .gz; its directory must exist. It is replaced
            in one step when all is written, and untouched on failure.
        columns: Header; the first should be `time`.
        values: One row a line, shape (n, len(columns)).

    Raises:
        DataError: Shapes that do not match, or a file that cannot be written.
    """
    if values.ndim != 2 or values.shape[1] != len(columns):
        raise DataError(f"{path}: {len(columns)} columns for values of shape {values.shape}")
    with replacing(Path(path)) as file:
        file.write((",".join(columns) + "\n").encode())
        for start in range(0, len(values), BLOCK):
            rows = values[start : start + BLOCK].tolist()
            file.write("".join(",".join(map(repr, row)) + "\n" for row in rows).encode())
