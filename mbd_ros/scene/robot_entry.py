"""The `robot` section of a scene -> a robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.robot_reader import EARTH_GRAVITY, read_robot
from mbd_ros.core.model.urdf import MAX_CHARACTERS
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene import schema
from mbd_ros.scene.locate import find_file
from mbd_ros.scene.strict_yaml import read_text


@dataclass(frozen=True)
class RobotEntry:
    """The `robot` section."""

    urdf: str | None = None
    description_topic: str | None = None
    gravity: Sequence[float] = EARTH_GRAVITY
    base: str = "fixed"
    locked: Mapping[str, float] | None = None
    rename: Mapping[str, str] | None = None


def read_entry(path: Path, section: Any) -> RobotEntry:
    """The section, checked.

    Raises:
        SceneError: Names file and key.
    """
    entry: RobotEntry = schema.call(RobotEntry, section, f"{path}: robot")
    if (entry.urdf is None) == (entry.description_topic is None):
        raise SceneError(f"{path}: robot: give either 'urdf' or 'description_topic'")
    if len(entry.gravity) != 3:
        raise SceneError(f"{path}: robot.gravity: expected 3 numbers, got {entry.gravity}")
    return entry


def build_robot(path: Path, entry: RobotEntry, description: str | None) -> tuple[Robot, str]:
    """The robot, and the file or topic that describes it.

    Args:
        path: Scene file.
        entry: Its `robot` section.
        description: URDF that arrived on the topic of the section.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    if entry.urdf is not None:
        source, text = _read_urdf(path, entry.urdf)
    elif description is not None:
        source, text = f"topic {entry.description_topic}", description
    else:
        raise SceneError(
            f"{path}: robot: the description comes from topic {entry.description_topic}, which "
            "only a node can read; give 'urdf' to use the scene offline"
        )
    try:
        robot = _robot(text, source, entry)
    except ModelError as error:
        raise SceneError(f"{path}: robot: {error}{_joints_to_lock(text, entry)}") from error
    return robot, source


def _robot(text: str, source: str, entry: RobotEntry) -> Robot:
    return read_robot(
        text,
        source=source,
        gravity=entry.gravity,
        base=entry.base,
        locked=entry.locked,
        rename=entry.rename,
    )


def _joints_to_lock(text: str, entry: RobotEntry) -> str:
    """The joints there are, where nothing but `locked` is wrong."""
    if not entry.locked:
        return ""
    try:
        robot = _robot(text, "", replace(entry, locked=None))
    except ModelError:
        return ""
    return f"; the robot has {', '.join(joint.name for joint in robot.joints)}"


def _read_urdf(path: Path, name: str) -> tuple[str, str]:
    where = f"{path}: robot.urdf"
    file = find_file(path.parent, name, where)
    try:
        return str(file), read_text(file, MAX_CHARACTERS, "robot description")
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error
