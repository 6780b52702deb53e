"""Numbers in CSV files, plain or gzip: strict when read, whole or not at all when written."""

import gzip
import os
import re
import uuid
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.errors import DataError

NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
# Besides digits only the letters of "nan" pass: float() would take inf, 1_000 and foreign digits.
CHARACTERS = b"0123456789+-.eE,\nnaN"
BLOCK = 4096


class Table(NamedTuple):
    """One CSV file.

    Attributes:
        path: Where it was read from.
        columns: Names of the header line; the first is `time`.
        values: One row a line, shape (n, len(columns)); n >= 1, time strictly increasing.
    """

    path: Path
    columns: tuple[str, ...]
    values: NDArray[np.float64]


def read_table(path: str | Path, nan_allowed: Callable[[str], bool] | None = None) -> Table:
    """Read a table whose cells are all plain finite numbers.

    Args:
        path: A .csv file, or .csv.gz.
        nan_allowed: Says by name which columns may hold `nan`; none without it.

    Raises:
        DataError: File, line and column of what is not acceptable.
    """
    path = Path(path)
    data = _read_bytes(path).replace(b"\r\n", b"\n")
    if not data.strip():
        raise DataError(f"{path}: is empty, expected a header line that begins with time")
    header, *lines = data.removesuffix(b"\n").split(b"\n")
    columns = _columns(path, header)
    if not lines:
        raise DataError(f"{path}: has a header and no data")
    values = _values(path, columns, lines, nan_allowed or (lambda column: False))
    late = np.flatnonzero(np.diff(values[:, 0]) <= 0)
    if late.size:
        before, time = values[late[0] : late[0] + 2, 0].tolist()
        raise DataError(
            f"{path}: line {late[0] + 3}, column time: {time!r} is not after {before!r} of the"
            " line before, time must strictly increase"
        )
    return Table(path, columns, values)


def _read_bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if path.suffix == ".gz" else data
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise DataError(f"{path}: truncated or corrupt gzip file ({error})") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error


def _columns(path: Path, header: bytes) -> tuple[str, ...]:
    try:
        columns = header.decode("utf-8-sig").split(",")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: line 1 is not text, expected a CSV header") from error
    if columns[0] != "time":
        raise DataError(f"{path}: line 1: first column is {columns[0][:40]!r}, expected 'time'")
    if "" in columns:
        raise DataError(f"{path}: line 1: column {columns.index('') + 1} has no name")
    repeated = sorted({name for name in columns if columns.count(name) > 1})
    if repeated:
        raise DataError(f"{path}: line 1 repeats column {', '.join(repeated)}")
    return tuple(columns)


def _values(
    path: Path,
    columns: tuple[str, ...],
    lines: list[bytes],
    nan_allowed: Callable[[str], bool],
) -> NDArray[np.float64]:
    """All cells at once; only when something is wrong are they looked at one by one."""
    width, cells = len(columns), array("d")
    clean = not any(line.translate(None, CHARACTERS) for line in lines)
    try:
        for number, line in enumerate(lines, 2):
            row = line.split(b",")
            if len(row) != width:
                raise DataError(f"{path}: line {number} has {len(row)} fields, expected {width}")
            if clean:
                cells.extend(map(float, row))
    except ValueError:
        clean = False
    values = np.frombuffer(cells).reshape(-1, width) if clean else np.full((1, width), np.inf)
    finite = np.isfinite(values) | (np.isnan(values) & [nan_allowed(name) for name in columns])
    if not finite.all():
        raise _first_bad_cell(path, columns, lines, nan_allowed)
    return values


def _first_bad_cell(
    path: Path,
    columns: tuple[str, ...],
    lines: list[bytes],
    nan_allowed: Callable[[str], bool],
) -> DataError:
    for number, line in enumerate(lines, 2):
        for column, cell in zip(columns, line.split(b","), strict=True):
            missing = cell in (b"nan", b"NaN") and nan_allowed(column)
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


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO | gzip.GzipFile]:
    """A file to write that takes the place of `path` on success and vanishes on failure."""
    if not path.parent.is_dir():
        raise DataError(f"{path}: directory {path.parent} does not exist")
    if path.exists() and not path.is_file():
        raise DataError(f"{path}: exists and is not a regular file")
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        with temporary.open("xb") as raw:
            if path.suffix == ".gz":
                with gzip.GzipFile("", "wb", compresslevel=4, fileobj=raw, mtime=0) as packed:
                    yield packed
            else:
                yield raw
        os.replace(temporary, path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
