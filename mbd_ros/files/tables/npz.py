""".npz: numpy's arrays in a zip file, every shape and bit, and a description as JSON."""

from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.files.tables.description import column_of, describe, described
from mbd_ros.files.text_file import replacing
from mbd_ros.npz_file import read_arrays

_DESCRIPTION = "description.json"


class Npz:
    """Arrays `<table>/<column>` and the text `description.json`, a byte an element."""

    content = "everything"
    one_table = False

    def holds(self, column: Column) -> bool:
        """Whether it can be written: everything can."""
        return True

    def write(self, path: Path, result: Result) -> None:
        """Write all tables; equal results give equal files."""
        arrays: dict[str, Any] = {
            _DESCRIPTION: np.frombuffer(describe(result).encode(), dtype=np.uint8)
        }
        for name, table in result.tables.items():
            for column, values in table.items():
                key = f"{name}/{column}"
                if key in arrays:
                    raise DataError(f"{path}: two columns would be called {key}")
                arrays[key] = values
        with replacing(path) as file:
            np.savez(cast(BinaryIO, file), allow_pickle=False, **arrays)

    def read(self, path: Path) -> Result:
        """Read a file that `write` wrote.

        Raises:
            DataError: Another file, or one that is cut or too large.
        """
        arrays = read_arrays(path, "a result of mbd_ros")
        try:
            tables, metadata = described(arrays[_DESCRIPTION].tobytes(), str(path))
            return Result(
                {
                    name: Table(column_of(e, arrays[f"{name}/{e['name']}"]) for e in entries)
                    for name, entries in tables.items()
                },
                metadata,
            )
        except KeyError as error:
            raise DataError(f"{path}: not a result of mbd_ros (no array {error})") from error
