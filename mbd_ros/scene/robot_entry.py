"""The `robot` section of a scene -> a robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.robot_reader import EARTH_GRAVITY, read_robot
from mbd_ros.core.model.urdf import MAX_CHARACTERS
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene import schema
from mbd_ros.scene.building import Site
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


def read_entry(where: str, given: Any, has_text: bool = False) -> RobotEntry:
    """The section, checked.

    Args:
        where: File and key, for the messages.
        given: What the file holds.
        has_text: Whether a description came with the scene, so that none need be named.

    Raises:
        SceneError: Names file and key.
    """
    entry: RobotEntry = schema.call(RobotEntry, given, where)
    named = (entry.urdf is not None) + (entry.description_topic is not None)
    if named != 1 and not (has_text and not named):
        raise SceneError(f"{where}: give either 'urdf' or 'description_topic'")
    if len(entry.gravity) != 3:
        raise SceneError(f"{where}.gravity: expected 3 numbers, got {entry.gravity}")
    return entry


def build_robot(site: Site, given: Any) -> Robot:
    """The `robot` section.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    where, text = site.where, site.origin.description
    entry = read_entry(where, given, site.origin.path is None and text is not None)
    if entry.urdf is not None:
        source, text = _read_urdf(site, entry.urdf)
    elif text is None:
        raise SceneError(
            f"{where}: the description comes from topic {entry.description_topic}, which only a "
            "node can read; give 'urdf' to use the scene offline"
        )
    else:
        source = f"topic {entry.description_topic}" if entry.description_topic else "URDF text"
    try:
        return _robot(text, source, entry)
    except ModelError as error:
        raise SceneError(f"{where}: {error}{_joints_to_lock(text, entry)}") from error


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


def _read_urdf(site: Site, name: str) -> tuple[str, str]:
    where = f"{site.where}.urdf"
    file = find_file(site.origin.folder, name, where)
    try:
        return str(file), read_text(file, MAX_CHARACTERS, "robot description")
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error
