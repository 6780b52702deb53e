"""Rows of numbers that wait for those who read some of them, many in a file."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.errors import DataError

_IN_MEMORY = 2**24  # bytes that need no file


class Spool:
    """Rows that wait in memory while they are few, else in a file without a name.

    Args:
        folder: Where there is room.
        width: Numbers in a row.
        kind: Of the numbers.

    Attributes:
        rows: How many there are.

    Raises:
        DataError: The folder has no room.
    """

    def __init__(self, folder: Path, width: int, kind: type[np.generic] = np.float64) -> None:
        self._folder, self.width, self._kind, self.rows = folder, width, np.dtype(kind), 0
        self._newest: list[NDArray[Any]] = []
        self._filed = 0  # rows in the file
        with self._failing():
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 closed on leaving

    def append(self, values: NDArray[Any]) -> None:
        """Add rows, shape (n, width) or, of one number each, (n,); they must stay as they are."""
        self._newest.append(np.asarray(values, self._kind).reshape(-1, self.width))
        self.rows += len(values)
        if (self.rows - self._filed) * self.width * self._kind.itemsize > _IN_MEMORY:
            with self._failing():
                self._file.seek(0, 2)
                for rows in self._newest:
                    self._file.write(np.ascontiguousarray(rows).data)
            self._newest, self._filed = [], self.rows

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Some rows that follow each other, shape (n, width); not to be written to."""
        begin, end, _ = rows.indices(self.rows)
        found = [self._from_file(begin, min(end, self._filed))] if begin < self._filed else []
        first = self._filed
        for piece in self._newest:
            own = piece[max(begin - first, 0) : max(end - first, 0)]
            found += [own] if len(own) else []
            first += len(piece)
        nothing = np.zeros((0, self.width), self._kind)
        return found[0] if len(found) == 1 else np.concatenate([nothing, *found])

    def _from_file(self, begin: int, end: int) -> NDArray[Any]:
        size = self._kind.itemsize * self.width
        with self._failing():
            self._file.seek(size * begin)
            data = self._file.read(size * max(end - begin, 0))
        return np.frombuffer(data, self._kind).reshape(-1, self.width)

    def __enter__(self) -> "Spool":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._failing():
            self._file.close()

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise DataError(
                f"{self._folder}: no room for what has to wait ({error.strerror})"
            ) from error


class StampSpool:
    """Stamps [ns] in a spool of one number a row.

    Args:
        spool: The numbers, of the kind int64.
    """

    def __init__(self, spool: Spool) -> None:
        self._spool = spool

    def append(self, stamps: NDArray[np.int64]) -> None:
        """Add some, shape (n,)."""
        self._spool.append(stamps)

    def __len__(self) -> int:
        return self._spool.rows

    def __getitem__(self, rows: slice) -> NDArray[np.int64]:
        """Some that follow each other, shape (n,)."""
        return self._spool[rows][:, 0]
