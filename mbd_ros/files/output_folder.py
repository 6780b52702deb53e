"""Folders for results: names that come from files are no paths, and nothing leaves the folder."""

import re
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from mbd_ros.errors import DataError
from mbd_ros.files.text_file import replacing

_ODD = re.compile(r"[^\w.-]|^[^\w]")  # a leading dot hides a file, a leading - makes it an option
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # by Windows
_LONGEST = 200  # bytes of a name without its suffix: names end at 255


def file_stem(name: str) -> str:
    """A name of a model, a person or a scene as the name of a file without its suffix.

    It is one word that every system takes: letters, digits, `_`, `.` and `-`, at most 200 bytes.

    Args:
        name: Any text, such as an attribute in a file of others.
    """
    shortened = name.encode(errors="replace")[:_LONGEST].decode(errors="ignore")
    stem = _ODD.sub("_", shortened) or "_"
    return f"_{stem}" if _RESERVED.fullmatch(stem) else stem


def comment_line(text: str) -> str:
    """A line of comment, whatever names of others stand in it."""
    return "".join(c if c.isprintable() else " " for c in f"# {text}") + "\n"


def place_in(folder: Path, *names: str) -> Path:
    """The place of a file or folder in a folder for results, symbolic links resolved.

    Args:
        folder: What the user named; it may be a link itself.
        *names: Folders below it, then the file or folder; one word each.

    Raises:
        DataError: A name is a path, or a folder below is a link that leads out.
    """
    for name in names:
        if name in ("", ".", "..") or set("/\\\0") & set(name):
            raise DataError(f"{folder}: {name!r} is no name of a file")
    place = folder.joinpath(*names)
    inner = place if place.is_dir() else place.parent  # a link to a file is replaced, not followed
    try:
        is_inside = inner.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:  # links in a circle
        raise DataError(f"{place}: cannot be written ({error})") from error
    if not is_inside:
        raise DataError(f"{inner}: is a link that leads out of {folder}, nothing is written there")
    return place


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, where they are missing.

    Raises:
        DataError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be made ({error.strerror})") from error


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files of a folder, which is made where it is missing; all, or none.

    Raises:
        DataError: The folder or a file cannot be written.
    """
    make_folder(folder)
    with ExitStack() as stack:  # each takes its place when all are written
        for name, content in files.items():
            stack.enter_context(replacing(place_in(folder, name))).write(content)
