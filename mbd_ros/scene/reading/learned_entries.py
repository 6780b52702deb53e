"""Files of learned models that parts name."""

import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbd_ros.core.contracts import Load
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.learned_model import LARGEST, About, LearnedFile, check_physics, physics_of
from mbd_ros.regular_file import open_regular
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file


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
    hints, arguments = typing.get_type_hints(part.__init__), dict(entry)
    for key in arguments.keys() & hints.keys():
        if hints[key] is LearnedFile and not isinstance(arguments[key], LearnedFile):
            name: str = schema.value(arguments[key], str, f"{where}.{key}")
            arguments[key] = _read(find_file(folder, name, f"{where}.{key}"), f"{where}.{key}")
    return arguments


def physics_beside(scene: Scene, description: About) -> dict[str, list[float]]:
    """Return the forces of the scene beside a learned model, see `physics_of`."""
    forces = scene.parts.get("forces", ())
    others = [part for part in forces if not is_learned(part)]
    return physics_of(scene.robot, scene.couplings, others, description)


def is_learned(part: Load) -> bool:
    """Whether a part is a learned model."""
    return isinstance(getattr(part, "description", None), About)


def check_models(scene: Scene) -> None:
    """Refuse models that were learned beside other forces than those of the scene.

    Raises:
        SceneError: Names the scene, the file and what differs.
    """
    for part in filter(is_learned, scene.parts.get("forces", ())):
        try:
            check_physics(part.file, part.description, physics_beside(scene, part.description))
        except ModelError as error:
            raise SceneError(f"{scene.name}: forces: {error}") from error


def _read(path: Path, where: str) -> LearnedFile:
    try:
        with open_regular(path) as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise SceneError(f"{where}: {path} cannot be read: {error.strerror}") from error
    if len(content) > LARGEST:
        raise SceneError(f"{where}: {path} has more than {LARGEST} bytes")
    return LearnedFile(str(path), content)
