"""Rows of numbers that wait in a file for those who read some of them."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError


class Spool:
    """Rows in a file that has no name and is gone when it is closed.

    Args:
        folder: Where there is room.
        width: Numbers in a row.

    Attributes:
        rows: How many there are.

    Raises:
        DataError: The folder has no room.
    """

    def __init__(self, folder: Path, width: int) -> None:
        self._folder, self._width, self.rows = folder, width, 0
        with self._failing():
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 closed on leaving

    def append(self, values: Array) -> None:
        """Add rows, shape (n, width)."""
        with self._failing():
            self._file.seek(0, 2)
            self._file.write(np.ascontiguousarray(values, dtype=np.float64).data)
        self.rows += len(values)

    def __getitem__(self, rows: slice) -> Array:
        """Some rows that follow each other, shape (n, width)."""
        begin, end, _ = rows.indices(self.rows)
        with self._failing():
            self._file.seek(8 * self._width * begin)
            data = self._file.read(8 * self._width * max(end - begin, 0))
        return np.frombuffer(data).reshape(-1, self._width)

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


class Columns:
    """Some columns of a spool, by rows.

    Args:
        spool: The whole.
        columns: Those that are given.
    """

    def __init__(self, spool: Spool, columns: slice) -> None:
        self._spool, self._columns = spool, columns

    def __getitem__(self, rows: slice) -> Array:
        """Some rows, shape (n, m)."""
        return self._spool[rows][:, self._columns]
