""".parquet: one table of every shape, to the bit; metadata in the schema. Needs pyarrow."""

from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import DataError, install_hint
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.files.tables.description import column_of, describe, described
from mbd_ros.files.text_file import replacing
from mbd_ros.regular_file import check_regular

_KEY = b"mbd_ros"


class Parquet:
    """Columns of numbers, texts, and of lists of equal length for arrays (row by row).

    Raises:
        DataError: pyarrow is not installed.
    """

    content = "everything"
    one_table = True

    def __init__(self) -> None:
        try:
            import pyarrow.parquet
        except ModuleNotFoundError as error:
            raise DataError(f".parquet: {install_hint('pyarrow')}") from error
        self._arrow, self._storage = pyarrow, pyarrow.parquet

    def holds(self, column: Column) -> bool:
        """Whether it can be written: everything can."""
        return True

    def write(self, path: Path, result: Result) -> None:
        """Write a table."""
        arrow, storage = self._arrow, self._storage
        ((name, table),) = result.tables.items()
        arrays = [_packed(arrow, column.values) for column in table.columns]
        shapes = {n: {"shape": v.shape[1:], "dtype": v.dtype.str} for n, v in table.items()}
        schema = arrow.schema(
            [arrow.field(n, array.type) for n, array in zip(table, arrays, strict=True)],
            {_KEY: describe(result, {name: shapes}).encode()},
        )
        with replacing(path) as file:
            storage.write_table(arrow.table(arrays, schema=schema), file)

    def read(self, path: Path) -> Result:
        """What `write` wrote; of files of others the columns of numbers and texts.

        Raises:
            DataError: Another file, or one that is cut.
        """
        arrow, storage = self._arrow, self._storage
        try:
            check_regular(path)
            read = storage.ParquetFile(path).read()
            text = (read.schema.metadata or {}).get(_KEY)
            if text is None:
                plain = zip(read.column_names, read.columns, strict=True)
                return Result({MAIN: Table(Column(n, c.to_numpy()) for n, c in plain)})
            tables, metadata = described(text, str(path))
            ((name, entries),) = tables.items()
            columns = [column_of(entry, _unpacked(read, entry)) for entry in entries]
        except (arrow.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path}: not a parquet file, or corrupt ({error})") from error
        return Result({name: Table(columns)}, metadata)


def _packed(arrow: Any, values: Any) -> Any:
    flat = arrow.array(np.ascontiguousarray(values).reshape(-1))
    for size in reversed(values.shape[1:]):
        flat = arrow.FixedSizeListArray.from_arrays(flat, size)
    return flat


def _unpacked(read: Any, entry: dict[str, Any]) -> Any:
    """The values of a column in the shape and type that its description says.

    Raises:
        ValueError: They have others.
    """
    name, shape, kind = entry["name"], entry["shape"], np.dtype(entry["dtype"])
    if kind.kind not in "fiubU" or not all(isinstance(size, int) for size in shape):
        raise ValueError(f"column {name}: {kind} of shape {shape}")
    values = read.column(name).combine_chunks()
    for size in shape:
        if getattr(values.type, "list_size", None) != size:
            raise ValueError(f"column {name}: {values.type} are not {size} numbers a row")
        values = values.flatten()
    plain = np.array(values.to_numpy(zero_copy_only=False), dtype=kind)
    return plain.reshape(read.num_rows, *shape)
