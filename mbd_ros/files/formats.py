"""Formats of files: suffix -> reader and writer, imported when a path asks for one.

Other packages add formats by entry points of the group `mbd_ros.formats`: the name is the suffix
without its dot, the value `package.module:Class`. They are looked up for unknown suffixes only.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_ros.errors import DataError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "mbd_ros.formats"
FOLDER = ""  # suffix of a bag that is a folder
BAGS = (FOLDER, ".mcap", ".db3")
STORAGES = (".mot", ".mot.gz", ".sto", ".sto.gz")
PICTURES = (".png", ".svg", ".pdf")
FORMATS = {  # suffix -> class; of two suffixes that fit the longer one counts
    **dict.fromkeys((".csv", ".csv.gz"), "mbd_ros.files.tables.csv:Csv"),
    **dict.fromkeys(BAGS, "mbd_ros.files.bags.bag:Bag"),
    ".npz": "mbd_ros.files.tables.npz:Npz",
    ".parquet": "mbd_ros.files.tables.parquet:Parquet",
    **dict.fromkeys(STORAGES, "mbd_ros.files.laboratory.storage:Storage"),
    **dict.fromkeys((".trc", ".trc.gz"), "mbd_ros.files.laboratory.trc:Trc"),
    ".c3d": "mbd_ros.files.laboratory.c3d:C3d",
    **dict.fromkeys(PICTURES, "mbd_ros.files.plot:Plot"),
}


def format_of(path: str | Path) -> Any:
    """Return the format of a path, a `mbd_ros.files.table.Format`.

    Raises:
        DataError: No format has its suffix, or one that is installed cannot be imported.
    """
    suffix = suffix_of(path)
    if suffix in FORMATS:
        return format_with(suffix)
    entry = _installed()[suffix]
    try:
        return entry.load()()
    except (ImportError, AttributeError) as error:
        raise DataError(
            f"{path}: the format {entry.value} of {suffix} cannot be imported: {error}"
        ) from error


def format_with(suffix: str) -> Any:
    """Import and return the format of this package that has a suffix."""
    module, _, name = FORMATS[suffix].partition(":")
    return getattr(import_module(module), name)()


def suffix_of(path: str | Path) -> str:
    """Return the suffix that chooses the format of a path; `FOLDER` for a folder or without any.

    Raises:
        DataError: No format has it; says which there are.
    """
    path = Path(path)
    if path.is_dir() or not path.suffix:
        return FOLDER
    fitting = [suffix for suffix in FORMATS if suffix and path.name.endswith(suffix)]
    fitting = fitting or [suffix for suffix in _installed() if path.name.endswith(suffix)]
    if not fitting:
        readable = [suffix for suffix in FORMATS if suffix not in PICTURES]
        accepted = listed([*readable, *_installed()])
        raise DataError(f"{path}: no format has this suffix; accepted: {accepted}")
    return max(fitting, key=len)


def is_bag(path: str | Path) -> bool:
    """Whether a path names a bag: a folder, .mcap, .db3 or no suffix.

    Raises:
        DataError: No format has its suffix.
    """
    return suffix_of(path) in BAGS


def listed(suffixes: Collection[str]) -> str:
    """Suffixes for people; the folder of a bag has none."""
    named = ", ".join(suffix for suffix in suffixes if suffix)
    return f"{named}{' or the folder of a bag' if FOLDER in suffixes else ''}"


@cache
def _installed() -> dict[str, EntryPoint]:
    """Formats of other packages by suffix."""
    from importlib.metadata import entry_points  # here, since most suffixes are known

    return {f".{entry.name.removeprefix('.')}": entry for entry in entry_points(group=GROUP)}
