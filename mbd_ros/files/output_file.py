"""Files that appear whole or not at all, and what a result must not replace."""

import gzip
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import check_target
from mbd_ros.files.formats import format_of, is_bag

_SHOWN = 40  # characters of a name in that of a temporary file: names end at 255 bytes


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
