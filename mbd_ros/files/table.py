"""The result of every job: tables by name, columns with name, unit, frame and any shape.

A result is written to and read from files; the suffix of a path chooses the format. Columns `time`
[s] and, where seconds as floats cannot tell nanoseconds apart, `stamp` [ns] say when a row was.
"""

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError, install_hint, printable
from mbd_ros.files.formats import format_of, format_with, listed, suffix_of

MAIN = "samples"  # the table that every job has
TIME, STAMP = "time", "stamp"
RUN = "run"  # in a table of many runs, its first column
TIME_LIMIT = 9e9  # s: int64 nanoseconds end at 9.22e9 s
_HEADER = 1  # lines above the rows of a table
_LISTED = 4  # tables, and names, in a text
_SHOWN = 5  # columns, and rows, of each end, in a notebook


class Column(NamedTuple):
    """One quantity, a value a row.

    Attributes:
        name: As `knee.position`.
        values: Shape (n, *shape): numbers, truth values or texts.
        unit: Empty for texts and pure numbers.
        frame: In whose axes vectors are; empty for scalars.
    """

    name: str
    values: NDArray[Any]
    unit: str = ""
    frame: str = ""

    @property
    def label(self) -> str:
        """Name, unit and frame for people."""
        where = f" in {self.frame}" if self.frame else ""
        return self.name + (f" [{self.unit}]" if self.unit else "") + where


class Table(Mapping[str, NDArray[Any]]):
    """Columns of equal length; reads as a mapping from name to values.

    Equal are tables with the same columns in the same order: names, units, frames, kinds, shapes
    and values, one NaN as good as another.

    Args:
        columns: The columns, in their order.

    Raises:
        DataError: Names that repeat, lengths that differ, or values of another kind.
    """

    def __init__(self, columns: Iterable[Column]) -> None:
        self.columns = tuple(one._replace(values=np.asarray(one.values)) for one in columns)
        self._at = {column.name: column for column in self.columns}
        if len(self._at) < len(self.columns):
            names = [column.name for column in self.columns]
            repeated = sorted({name for name in names if names.count(name) > 1})
            raise DataError(f"columns must have names of their own, repeated: {_some(repeated)}")
        for name, values in self.items():
            if values.ndim < 1 or values.dtype.kind not in "fiubU":
                raise DataError(
                    f"column {name}: {values.dtype} of shape {values.shape}; accepted are "
                    "numbers, truth values and texts, one a row"
                )
            if len(values) != self.rows:
                raise DataError(
                    f"columns of unequal length: {self.columns[0].name} has {self.rows} rows, "
                    f"{name} has {len(values)}"
                )

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.column(name).values

    def __iter__(self) -> Iterator[str]:
        return iter(self._at)

    def __len__(self) -> int:
        return len(self.columns)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Table):
            return NotImplemented
        pairs = zip(self.columns, other.columns, strict=False)
        return len(self) == len(other) and all(_same(*pair) for pair in pairs)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Table of {self.rows} rows: {_some([column.label for column in self.columns])}"

    def _repr_html_(self) -> str:
        """First and last rows and columns, for a notebook."""
        return _table_html(self)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.columns[0].values) if self.columns else 0

    def column(self, name: str) -> Column:
        """The column of a name.

        Raises:
            DataError: There is none; says which there are.
        """
        try:
            return self._at[name]
        except KeyError:
            from mbd_ros.scene.schema.renamed import renamed  # here, since it serves errors only

            hint = f"{renamed('column', name, self)}; there are: {_some(list(self))}"
            raise MissingColumnError(f"no column {name}{hint}") from None

    def first(self, count: int) -> "Table":
        """The first rows alone."""
        return Table(column._replace(values=column.values[:count]) for column in self.columns)


class MissingColumnError(DataError, KeyError):
    """A column or table that is not there: names it and those that are."""

    def __str__(self) -> str:  # that of KeyError puts a sentence in quotes
        return DataError.__str__(self)


class Result(Mapping[str, Table]):
    """The result of a job: tables by name, and their origin.

    Args:
        tables: Name -> table; that of the job itself is `samples`.
        metadata: What JSON holds: scene, inputs, versions, seed, remarks.

    Raises:
        DataError: Metadata of another kind.
    """

    def __init__(
        self, tables: Mapping[str, Table], metadata: Mapping[str, Any] | None = None
    ) -> None:
        self.tables = dict(tables)
        try:  # a result reads back equal, so it holds what a file would
            self.metadata: dict[str, Any] = json.loads(json.dumps(dict(metadata or {})))
        except (TypeError, ValueError) as error:
            raise DataError(f"metadata: {error}") from error

    def __getitem__(self, name: str) -> Table:
        try:
            return self.tables[name]
        except KeyError:
            there = _some(list(self.tables))
            raise MissingColumnError(f"no table {name}; there are: {there}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __len__(self) -> int:
        return len(self.tables)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Result):
            return NotImplemented
        return self.tables == other.tables and self.metadata == other.metadata

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        lines = [f"  {name}: {table!r}" for name, table in list(self.tables.items())[:_LISTED]]
        if len(self) > _LISTED:
            lines.append(f"  and {len(self) - _LISTED} more tables")
        about = _some(list(self.metadata)) if self.metadata else "none"
        return "\n".join([f"Result, tables: {len(self)}", *lines, f"  metadata: {about}"])

    def _repr_html_(self) -> str:
        """The first tables, for a notebook."""
        shown = list(self.tables.items())[:_LISTED]
        from html import escape

        return "".join(f"<h4>{escape(name)}</h4>{_table_html(table)}" for name, table in shown)

    def to(self, path: str | Path, *, among: Collection[str] = (), **options: Any) -> None:
        """Write a file; its suffix chooses the format, see `formats`.

        Args:
            path: The file, or the folder of a bag.
            among: Suffixes that are accepted; all that are known without any.
            **options: Those of the format; of one that holds a single table also `table`.

        Raises:
            DataError: A suffix that no format has, what the format cannot hold, or a place that
                cannot be written to; nothing is left behind then.
        """
        if among and suffix_of(path) not in among:
            raise DataError(f"{path}: expected the suffix {listed(among)}")
        chosen: Format = format_of(path)
        tables = self.tables
        if chosen.one_table:
            name = options.pop("table", MAIN)
            tables = {name: self[name]}
        for column in (column for table in tables.values() for column in table.columns):
            if not chosen.holds(column):
                shape = " x ".join(map(str, column.values.shape[1:]))
                kind = f"{column.values.dtype.name}{f' of shape {shape}' if shape else ''}"
                raise DataError(
                    f"{path}: column {column.name} is {kind} a row, this format holds "
                    f"{chosen.content}; .npz and .parquet hold every shape"
                )
        chosen.write(Path(path), Result(tables, self.metadata), **options)

    def to_csv(self, path: str | Path, **options: Any) -> None:
        """Write a .csv or .csv.gz: scalar columns, no metadata."""
        self.to(path, among=(".csv", ".csv.gz"), **options)

    def to_bag(self, path: str | Path, **options: Any) -> None:
        """Write a rosbag2 folder, or a file ending in .mcap or .db3."""
        self.to(path, among=("", ".mcap", ".db3"), **options)

    def to_npz(self, path: str | Path, **options: Any) -> None:
        """Write a .npz: every shape, to the bit."""
        self.to(path, among=(".npz",), **options)

    def to_parquet(self, path: str | Path, **options: Any) -> None:
        """Write a .parquet: every shape, to the bit; needs pyarrow."""
        self.to(path, among=(".parquet",), **options)

    def to_dataframe(self, table: str = MAIN) -> Any:
        """A pandas DataFrame of a table; an array in each cell of a column that is not scalar.

        Args:
            table: Name of the table.

        Raises:
            DataError: pandas is not installed, or there is no such table.
        """
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise DataError(install_hint("pandas")) from error
        return pandas.DataFrame({n: v if v.ndim == 1 else list(v) for n, v in self[table].items()})

    def plot(self, path: str | Path | None = None, **options: Any) -> Any:
        """A figure of matplotlib, also written to a .png, .svg or .pdf where a path is given.

        Options are those of `mbd_ros.files.plot.figure`: table, columns.
        """
        pictures = format_with(".png")
        drawn = pictures.figure(self, **options)
        if path is not None:
            pictures.save(drawn, Path(path))
        return drawn


def read_result(path: str | Path, **options: Any) -> Result:
    """Return what a file or bag holds.

    Args:
        path: The file, or the folder of a bag.
        **options: Those of the format.

    Raises:
        DataError: An unknown suffix, or what is wrong with the file.
    """
    chosen: Format = format_of(path)
    try:
        return chosen.read(Path(path), **options)
    except DataError as error:  # of a table that cannot be made, which knows no file
        if printable(str(path)) in str(error):
            raise
        raise DataError(f"{path}: {error}") from error


class Format(Protocol):
    """Reader and writer of the files of one suffix; `formats` lists them.

    Attributes:
        content: What a column may be, for people: `one number a row`.
        one_table: Whether a file holds a single table: `samples` where nothing else is asked for.
    """

    content: str
    one_table: bool

    def holds(self, column: Column) -> bool:
        """Whether a column can be written so that reading gives it back."""
        ...

    def read(self, path: Path, **options: Any) -> Result:
        """Return what a file holds; DataError names what is wrong with it."""
        ...

    def write(self, path: Path, result: Result, **options: Any) -> None:
        """Write columns that it holds; nothing is left behind where that fails."""
        ...


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
    return rounded(_times(table))


def _times(table: Table) -> Array:
    """Column `time` [s]; half precision, whose numbers end at 65504, could hold no stamps."""
    time = table[TIME]
    return time.astype(np.float64) if time.dtype == np.float16 else time


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
        time = _times(table)
        if not np.abs(time).max(initial=0.0) <= TIME_LIMIT:
            raise DataError(f"{where}: column time: beyond {TIME_LIMIT:g} s")
        stamps = np.round(time * 1e9).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        line = np.flatnonzero(np.diff(stamps) <= 0)[0] + _HEADER + 2
        raise DataError(f"{where}: line {line}, column time: less than 1 ns after the last")
    return stamps


def _same(column: Column, other: Column) -> bool:
    a, b = column.values, other.values
    alike = column[0] == other[0] and column[2:] == other[2:] and a.dtype.kind == b.dtype.kind
    return alike and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def _some(names: list[str]) -> str:
    """The first names of many, cut where they are long."""
    text = (", ".join(names[:_LISTED]) or "none")[:200]
    return text + (f" and {len(names) - _LISTED} more" if len(names) > _LISTED else "")


def _table_html(table: Table) -> str:
    """A table element; names are escaped, since they come from files of others."""
    from html import escape

    def cell(column: Column | None, row: int) -> str:
        if column is None or row < 0:
            return "…"
        value = column.values[row]
        return escape(f"{value:.6g}" if isinstance(value, np.floating) else str(value))

    columns = [table.columns[i] if i >= 0 else None for i in _ends(len(table.columns))]
    head = "".join(f"<th>{escape(c.label) if c else '…'}</th>" for c in columns)
    rows = [[f"<td>{cell(c, i)}</td>" for c in columns] for i in _ends(table.rows)]
    body = "".join(f"<tr>{''.join(cells)}</tr>" for cells in rows)
    size = f"<caption>{table.rows} rows, {len(table)} columns</caption>"
    return f"<table>{size}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _ends(count: int) -> list[int]:
    """Numbers of the first and last rows or columns; -1 stands for those between."""
    if count <= 2 * _SHOWN:
        return list(range(count))
    return [*range(_SHOWN), -1, *range(count - _SHOWN, count)]
