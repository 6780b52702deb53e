"""Scenes that Python makes: entries from Python values, and the robot from a file or a text."""

import inspect
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.origin import NO_FILE, Origin
from mbd_ros.scene.reader import build_scene
from mbd_ros.scene.schema.locate import find_file
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.schema.strict_yaml import MAX_DEPTH

_LARGEST_INTEGER = 10**18  # what a scene file takes for a number


def scene_from(
    entries: Mapping[str, Any] | None = None,
    *,
    urdf: str | Path | None = None,
    description: str | None = None,
) -> Scene:
    """Build a scene from Python values instead of a file.

    Args:
        entries: Sections as a scene file has them; numpy arrays and tuples stand for lists. A
            class stands for its name where a `type` is asked for. Relative paths start from the
            current folder.
        urdf: The robot: a file, `package://<package>/<path>`, the name of an embedded robot such
            as `arm7`, or URDF text. It joins the section `robot`, which may be left out then.
        description: URDF that arrived on the `description_topic` of the section `robot`.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    entry = plain(entries or {}, NO_FILE)
    if urdf is not None:
        robot = entry.get("robot") or {}
        if isinstance(robot, dict):
            given_by = {"urdf", "osim", "mjcf", "description_topic"}
            if description is not None or not given_by.isdisjoint(robot):
                raise SceneError(f"{NO_FILE}: robot: its description is given twice")
            if isinstance(urdf, str) and urdf.lstrip().startswith("<"):
                description, entry["robot"] = urdf, robot
            else:
                entry["robot"] = {**robot, "urdf": _robot_file(str(urdf))}
    return build_scene(Origin(description=description), entry)


def plain(value: Any, where: str, depth: int = 0) -> Any:
    """A Python value as a scene file would hold it.

    Args:
        value: Mappings, sequences and numpy arrays of numbers, words and None.
        where: Key, for the messages.
        depth: How deep the value lies.

    Raises:
        SceneError: Names the key of a value that no scene file holds.
    """
    if depth > MAX_DEPTH:
        raise SceneError(f"{where}: nested deeper than {MAX_DEPTH}")
    if isinstance(value, Mapping):
        joint = ": " if depth == 0 else "."
        return {
            _key(k, where): plain(v, f"{where}{joint}{k}", depth + 1) for k, v in value.items()
        }
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(v, f"{where}[{i}]", depth + 1) for i, v in enumerate(value)]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        raise SceneError(f"{where}: {value} is not a finite number")
    if type(value) is int and abs(value) >= _LARGEST_INTEGER:
        raise SceneError(f"{where}: {value} has too many digits")
    if value is None or type(value) in (bool, int, float, str) or inspect.isclass(value):
        return value
    raise SceneError(
        f"{where}: expected a number, a word, a list or a mapping, got {type(value).__name__}"
    )


def _key(key: Any, where: str) -> str:
    if not isinstance(key, str):
        raise SceneError(f"{where}: a key must be a word, got {key!r}")
    return key


def _robot_file(name: str) -> str:
    """A file, or that of an embedded robot where the name has neither suffix nor folder."""
    if name.startswith("package://") or Path(name).suffix or Path(name).is_file():
        return name
    try:
        return str(find_file(Path(), f"package://mbd_ros/config/robots/{name}.urdf", "robot"))
    except SceneError as error:
        folder = find_file(Path(), "package://mbd_ros/config/robots/arm7.urdf", "robot").parent
        known = [p.relative_to(folder).with_suffix("").as_posix() for p in folder.rglob("*.urdf")]
        close = nearest(name, known) or sorted(known)
        raise SceneError(
            f"{NO_FILE}: robot.urdf: '{name}' is no file, no URDF text and no embedded robot; "
            f"nearest: {', '.join(close)}"
        ) from error
