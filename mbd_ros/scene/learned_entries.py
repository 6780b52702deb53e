"""Files of learned models that parts name."""

import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbd_ros.core.learned.model_file import LARGEST, LearnedFile
from mbd_ros.errors import SceneError
from mbd_ros.scene import schema
from mbd_ros.scene.locate import find_file


def with_files(part: type, entry: Mapping[str, Any], where: str, folder: Path) -> dict[str, Any]:
    """An entry with contents of files in place of their names, for arguments of `LearnedFile`.

    Args:
        part: The class that takes the entry.
        entry: What the file holds.
        where: File and key, for the messages.
        folder: From which relative names start.

    Raises:
        SceneError: A name of no file, or of one that is too large.
    """
    hints, found = typing.get_type_hints(part.__init__), dict(entry)
    for key in found.keys() & hints.keys():
        if hints[key] is LearnedFile and not isinstance(found[key], LearnedFile):
            name: str = schema.value(found[key], str, f"{where}.{key}")
            found[key] = _read(find_file(folder, name, f"{where}.{key}"), f"{where}.{key}")
    return found


def _read(path: Path, where: str) -> LearnedFile:
    try:
        if not path.is_file():
            raise SceneError(f"{where}: {path} is no file")
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise SceneError(f"{where}: {path} cannot be read: {error.strerror}") from error
    if len(content) > LARGEST:
        raise SceneError(f"{where}: {path} has more than {LARGEST} bytes")
    return LearnedFile(str(path), content)
