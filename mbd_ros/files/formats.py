"""Formats of files: suffix -> reader and writer, imported when a path asks for one.

Other packages add formats by entry points of the group `mbd_ros.formats`: the name is the suffix
without its dot, the value `package.module:Class`. They are looked up for unknown suffixes only.
"""

from collections.abc import Collection
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol

from mbd_ros.errors import DataError
from mbd_ros.files.table import MAIN, Column, Result

GROUP = "mbd_ros.formats"
FOLDER = ""  # suffix of a bag that is a folder
BAGS = (FOLDER, ".mcap", ".db3")
STORAGES = (".mot", ".mot.gz", ".sto", ".sto.gz")
FORMATS = {  # suffix -> class; of two suffixes that fit the longer one counts
    **dict.fromkeys((".csv", ".csv.gz"), "mbd_ros.files.tables.csv:Csv"),
    **dict.fromkeys(BAGS, "mbd_ros.files.bags.bag:Bag"),
    ".npz": "mbd_ros.files.tables.npz:Npz",
    ".parquet": "mbd_ros.files.tables.parquet:Parquet",
    **dict.fromkeys(STORAGES, "mbd_ros.files.laboratory.storage:Storage"),
    **dict.fromkeys((".trc", ".trc.gz"), "mbd_ros.files.laboratory.trc:Trc"),
    ".c3d": "mbd_ros.files.laboratory.c3d:C3d",
    **dict.fromkeys((".png", ".svg", ".pdf"), "mbd_ros.files.plot:Plot"),
}
PICTURES = (".png", ".svg", ".pdf")
EVERYTHING = ".npz and .parquet hold every shape"


class Format(Protocol):
    """What reads and writes the files of one suffix.

    Attributes:
        content: What a column may be, for people: `one number a row`.
        one_table: Whether a file holds a single table: `samples` where nothing else is asked for.
    """

    content: str
    one_table: bool

    def holds(self, column: Column) -> bool:
        """Whether a column can be written so that reading gives it back."""
        ...

    def read(self, path: Path) -> Result:
        """What a file holds; DataError names what is wrong with it."""
        ...

    def write(self, path: Path, result: Result, **options: Any) -> None:
        """Write columns that it holds; nothing is left behind where that fails."""
        ...


def suffix_of(path: str | Path) -> str:
    """The suffix that chooses the format of a path; `FOLDER` for a folder, and without any.

    Raises:
        DataError: No format has it; says which there are.
    """
    path = Path(path)
    if path.is_dir() or not path.suffix:
        return FOLDER
    fitting = [suffix for suffix in FORMATS if suffix and path.name.endswith(suffix)]
    fitting = fitting or [suffix for suffix in _installed() if path.name.endswith(suffix)]
    if not fitting:
        raise DataError(f"{path}: no format has this suffix; accepted: {_accepted()}")
    return max(fitting, key=len)


def format_of(path: str | Path) -> Format:
    """The format of a path.

    Raises:
        DataError: No format has its suffix, or one that is installed cannot be imported.
    """
    suffix = suffix_of(path)
    if suffix in FORMATS:
        module, _, name = FORMATS[suffix].partition(":")
        return getattr(import_module(module), name)()
    entry = _installed()[suffix]
    try:
        return entry.load()()
    except (ImportError, AttributeError) as error:
        raise DataError(
            f"{path}: the format {entry.value} of {suffix} cannot be imported: {error}"
        ) from error


def is_bag(path: str | Path) -> bool:
    """Whether a path names a bag: a folder, .mcap, .db3 or no suffix.

    Raises:
        DataError: No format has its suffix.
    """
    return suffix_of(path) in BAGS


def read_result(path: str | Path, **options: Any) -> Result:
    """What a file or bag holds.

    Args:
        path: The file, or the folder of a bag.
        **options: Those of the format.

    Raises:
        DataError: An unknown suffix, or what is wrong with the file.
    """
    return format_of(path).read(Path(path), **options)


def write_result(
    path: str | Path, result: Result, among: Collection[str] = (), **options: Any
) -> None:
    """Write a result; see `Result.to`."""
    if among and suffix_of(path) not in among:
        raise DataError(f"{path}: expected the suffix {_listed(among)}")
    chosen = format_of(path)
    tables = result.tables
    if chosen.one_table:
        name = options.pop("table", MAIN)
        tables = {name: result[name]}
    for column in (column for table in tables.values() for column in table.columns):
        if not chosen.holds(column):
            shape = " x ".join(map(str, column.values.shape[1:]))
            kind = f"{column.values.dtype.name}{f' of shape {shape}' if shape else ''}"
            raise DataError(
                f"{path}: column {column.name} is {kind} a row, this format holds "
                f"{chosen.content}; {EVERYTHING}"
            )
    chosen.write(Path(path), Result(tables, result.metadata), **options)


@cache
def _installed() -> dict[str, EntryPoint]:
    """Formats of other packages by suffix."""
    return {f".{entry.name.removeprefix('.')}": entry for entry in entry_points(group=GROUP)}


def _accepted() -> str:
    return _listed([suffix for suffix in FORMATS if suffix not in PICTURES] + list(_installed()))


def _listed(suffixes: Collection[str]) -> str:
    named = ", ".join(suffix for suffix in suffixes if suffix)
    return f"{named}{' or the folder of a bag' if FOLDER in suffixes else ''}"
