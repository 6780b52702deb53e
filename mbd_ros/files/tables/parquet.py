""".parquet: one table of every shape, to the bit; metadata in the schema. Needs pyarrow."""

from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import DataError, install_hint
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.files.tables.description import column_of, describe, described
from mbd_ros.files.text_file import replacing
from mbd_ros.gzip_file import MAX_UNPACKED
from mbd_ros.regular_file import check_regular

_KEY = b"mbd_ros"
_ROWS, _TEXT_ROWS = 2**16, 2**10  # that are unpacked at once; a text may be long
_WIDTHS = {"INT32": 4, "FLOAT": 4, "INT64": 8, "DOUBLE": 8, "INT96": 12}  # bytes of a value


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
        """Read a file that `write` wrote, or the columns of numbers and texts of another file.

        Raises:
            DataError: Another file, or one that is cut.
        """
        arrow = self._arrow
        try:
            check_regular(path)
            read = self._read(path)
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

    def _read(self, path: Path) -> Any:
        """The table of a file, of at most 2 GB unpacked, or the size of the file if that is more.

        A repeated value takes no room in a file, and what the file says of its sizes may be wrong.
        """
        limit = max(MAX_UNPACKED, path.stat().st_size)
        with self._storage.ParquetFile(path) as file:
            about = file.metadata
            groups = [about.row_group(i) for i in range(about.num_row_groups)]
            chunks = [group.column(i) for group in groups for i in range(group.num_columns)]
            declared = sum(
                chunk.num_values * _WIDTHS.get(chunk.physical_type, 0) for chunk in chunks
            )
            is_text = any(chunk.physical_type == "BYTE_ARRAY" for chunk in chunks)
            batches, size = [], 0
            if declared <= limit:
                for batch in file.iter_batches(_TEXT_ROWS if is_text else _ROWS):
                    batches.append(batch)
                    # values that rows only refer to are shared by all batches
                    size += sum(getattr(c, "indices", c).nbytes for c in batch.columns)
                    if size > limit:
                        break
            if max(declared, size) > limit:
                raise DataError(f"{path}: more than {limit} bytes when unpacked")
            return self._arrow.Table.from_batches(batches, file.schema_arrow)


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
