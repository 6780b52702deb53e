"""Lines of regular files, plain or gzip, and tables of numbers among blanks."""

from __future__ import annotations

import gzip
import os
import uuid
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import check_target
from mbd_ros.files.formats import format_of, is_bag
from mbd_ros.gzip_file import check_gzip, unpacked_gzip
from mbd_ros.regular_file import open_regular

MAX_LINE = 1_000_000  # bytes
MAX_COLUMNS = 10_000
MAX_CELLS = 100_000_000  # numbers, 800 MB
_BLOCK = 4096  # lines that become numbers at once
_MISSING = (b"nan", b"NaN", b"-nan", b"-nan(ind)")  # as C libraries write it
_SHOWN = 40  # characters of a name in that of a temporary file: names end at 255 bytes


@contextmanager
def reading(path: Path) -> Iterator[Any]:
    """The unpacked bytes of a regular file, as a stream.

    Raises:
        DataError: It cannot be read, its gzip is cut, or unpacks to more than 2 GB.
    """
    try:
        with open_regular(path) as raw:
            if path.suffix == ".gz":
                check_gzip(raw)
                yield unpacked_gzip(raw)
            else:
                yield raw
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise DataError(f"{path}: truncated or corrupt gzip file ({error})") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error


class Lines:
    """Lines of a file without their ends; a last empty one is none.

    Args:
        path: File, for the messages.
        file: Its bytes, as a stream.

    Attributes:
        ended: Whether the line that was read last had its end.

    Raises:
        DataError: When a line is too long.
    """

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file, self._number = path, file, 0
        self.ended = True

    def __iter__(self) -> Lines:
        return self

    def __next__(self) -> bytes:
        line: bytes = self._file.readline(MAX_LINE + 1)
        if not line:
            raise StopIteration
        self._number += 1
        if len(line) > MAX_LINE:
            raise DataError(
                f"{self._path}: line {self._number} has more than {MAX_LINE} bytes, not accepted"
            )
        self.ended = line.endswith(b"\n")
        return line.removesuffix(b"\n").removesuffix(b"\r")


def labels_of(path: Path, line: bytes, number: int) -> list[str]:
    """Labels of a header line, among tabs or, where it has none, blanks.

    Args:
        path: File, for the messages.
        line: The header line.
        number: Of the line in the file, for the messages.

    Raises:
        DataError: It is no text, or a label is empty.
    """
    try:
        text = line.decode("utf-8-sig").rstrip()
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: line {number} is not text, expected labels") from error
    labels = [label.strip() for label in text.split("\t")] if "\t" in text else text.split()
    if not labels:
        raise DataError(f"{path}: line {number}: expected labels, there are none")
    if "" in labels:
        raise DataError(f"{path}: line {number}: column {labels.index('') + 1} has no label")
    if len(labels) > MAX_COLUMNS:
        raise DataError(f"{path}: {len(labels)} columns, accepted are {MAX_COLUMNS}")
    return labels


def numbers_of(path: Path, lines: Iterator[bytes], labels: Sequence[str], first: int) -> Array:
    """Rows of numbers among blanks or tabs; empty lines are left out, nan is a number.

    Args:
        path: File, for the messages.
        lines: Its lines from number `first` on.
        labels: Of the columns.
        first: Number of the first of these lines in the file.

    Returns:
        Shape (n, len(labels)).

    Raises:
        DataError: Another number of cells, or a cell that is no finite number or nan.
    """
    rows, blocks, count = [], [], 0
    for number, line in enumerate(lines, first):
        cells = line.split()
        if not cells:
            continue
        if len(cells) != len(labels):
            raise DataError(
                f"{path}: line {number} has {len(cells)} numbers, expected {len(labels)}"
            )
        rows.append(_row(path, labels, cells, number))
        count += len(cells)
        if count > MAX_CELLS:
            raise DataError(f"{path}: more than {MAX_CELLS} numbers are not accepted")
        if len(rows) == _BLOCK:
            blocks.append(np.array(rows))
            rows = []
    blocks.append(np.array(rows).reshape(-1, len(labels)))
    return np.concatenate(blocks)


def _row(path: Path, labels: Sequence[str], cells: list[bytes], number: int) -> list[float]:
    try:
        row = list(map(float, cells))
    except ValueError:
        row = []
    if row and all(map(_is_plain, row, cells)):
        return row
    return [
        cell_number(path, label, cell, number) for label, cell in zip(labels, cells, strict=True)
    ]


def _is_plain(value: float, cell: bytes) -> bool:
    return value - value == 0.0 and b"_" not in cell


def cell_number(path: Path, label: str, cell: bytes, number: int) -> float:
    """The number of a cell, which may be nan; path, label and number of the line are for messages.

    Raises:
        DataError: It is no finite number, nor nan.
    """
    if cell in _MISSING:
        return float("nan")
    try:
        value = float(cell)
    except ValueError:
        value = np.inf
    if not _is_plain(value, cell):
        shown = cell[:40].decode("utf-8", "backslashreplace")
        raise DataError(
            f"{path}: line {number}, column {label}: {shown!r} is not a plain finite number or nan"
        )
    return value


def check_times(path: Path, times: Array) -> None:
    """Refuse times that are not finite or do not increase.

    Raises:
        DataError: Names the row, counted from 1 below the header.
    """
    if not len(times):
        raise DataError(f"{path}: has a header and no data")
    late = np.flatnonzero(~(np.diff(times) > 0) | ~np.isfinite(times[1:]))
    if late.size or not np.isfinite(times[0]):
        row = int(late[0]) + 1 if late.size else 0
        before = f" is not after {float(times[row - 1])!r} of the row before" if row else ""
        raise DataError(
            f"{path}: row {row + 1} of the data, column time: {float(times[row])!r}{before}, time "
            "must strictly increase"
        )


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO | gzip.GzipFile]:
    """A file to write that takes the place of `path` on success and vanishes on failure."""
    temporary = path.with_name(f".{path.name[:_SHOWN]}.{uuid.uuid4().hex}.tmp")
    try:
        if not path.parent.is_dir():
            raise DataError(f"{path}: directory {path.parent} does not exist")
        if path.exists() and not path.is_file():
            raise DataError(f"{path}: exists and is not a regular file")
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


def check_place(out: Path) -> None:
    """Refuse a place that no result can be written to, before work is done for it.

    Raises:
        DataError: What is wrong with it, or what is not installed.
    """
    format_of(out)
    if is_bag(out):
        check_target(out)
    elif not out.parent.is_dir():
        raise DataError(f"{out}: directory {out.parent} does not exist")
    elif out.exists() and not out.is_file():
        raise DataError(f"{out}: exists and is not a regular file")


def refuse_overwriting(out: Path, *sources: Path | None) -> None:
    """Refuse a result in the place of what it is computed from.

    Args:
        out: Table, bag or folder to write.
        *sources: Files and bags that are read; None for those that are not given.

    Raises:
        DataError: A source is `out`, or inside of it, or a bag that `out` is a file of.
    """
    place = out.resolve()
    for source in filter(None, sources):
        read = source.resolve()
        is_inside = read in place.parents and is_bag(out)
        if place == read or place in read.parents or is_inside:
            raise DataError(
                f"-o {out}: the result would take the place of {source}, which is read; choose "
                "another name"
            )


def repeated_among(labels: Sequence[str]) -> list[str]:
    """Labels that stand there more than once, in order."""
    return sorted(label for label, count in Counter(labels).items() if count > 1)
