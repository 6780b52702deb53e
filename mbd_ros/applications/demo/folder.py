"""A folder that takes its place as a whole, or not at all."""

import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mbd_ros.errors import DataError


@contextmanager
def replacing_folder(path: Path, known: Collection[str]) -> Iterator[Path]:
    """A new folder to fill that becomes `path` when the `with` block ends well.

    Args:
        path: A folder, which need not exist; only one that holds nothing but `known` is replaced.
        known: Names of what may be there from the last time.

    Raises:
        DataError: The place is taken, or cannot be written to.
    """
    path = Path(os.path.abspath(path))
    _check(path, known)
    try:
        room = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        new = room / path.name
        new.mkdir()
        yield new
        _check(path, known)
        _put(new, path, room / "old")
    finally:
        shutil.rmtree(room, ignore_errors=True)


def _check(path: Path, known: Collection[str]) -> None:
    if not path.parent.is_dir():
        raise DataError(f"{path}: directory {path.parent} does not exist")
    if not (path.exists() or path.is_symlink()):
        return
    if path.is_symlink() or not path.is_dir():
        raise DataError(f"{path}: exists and is no folder, not replaced")
    if strange := sorted({entry.name for entry in path.iterdir()} - set(known)):
        raise DataError(f"{path}: holds {strange[0]}, which is not of a demo; not replaced")


def _put(new: Path, path: Path, old: Path) -> None:
    try:
        if path.exists():
            os.rename(path, old)
        os.rename(new, path)
    except OSError as error:
        with suppress(OSError):
            os.rename(old, path)
        raise DataError(f"{path}: cannot be written ({error.strerror})") from error
