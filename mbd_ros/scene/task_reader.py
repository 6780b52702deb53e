"""Task file -> a task for a scene, by the reader of scenes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.reading.building import build, present, refuse_unknown
from mbd_ros.scene.schema.locate import find_task
from mbd_ros.scene.schema.sections import TASKS, keys
from mbd_ros.scene.schema.strict_yaml import read_mapping


class Task(NamedTuple):
    """A task for a scene.

    Attributes:
        parts: The built sections, by key: `parts["simulate"]` is a `SimulateTask`.
        entries: The sections as given, by key.
    """

    path: Path
    scene: Scene
    parts: Mapping[str, Any]
    entries: Mapping[str, Any]


def read_task(path: str | Path, scene: Scene) -> Task:
    """Read a task for a scene.

    Args:
        path: Task file, `package://<package>/<path>`, or the name of an embedded task.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    path = find_task(path)
    origin, entries = Origin(path), read_mapping(path, "task file")
    refuse_unknown(origin, [key for key in entries if key not in keys(TASKS)], TASKS)
    entries = present(entries)
    if not entries:
        raise SceneError(f"{path}: asks for nothing, accepted: {', '.join(keys(TASKS))}")
    return Task(path, scene, build(origin, entries, TASKS, scene=scene).parts, entries)
