"""Names of parts: given by `name`, or else made of joint or frame and type; unique in a scene."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from mbd_ros.core.contracts import type_name
from mbd_ros.core.model.robot import BASE, Robot
from mbd_ros.errors import ModelError, SceneError

_NAME, _OTHER = re.compile(r"[\w/-]{1,255}"), re.compile(r"[^\w/-]")
# Keys that say where a part is.
_PLACES = ("joint", "joints", "frame", "frame_b", "frame_a", "path")


class NamedEntry(NamedTuple):
    """An entry of a part.

    Attributes:
        where: File and key, for the messages.
        given: What the file holds, without the name.
        name: As given; None leaves it to `name_parts`.
    """

    where: str
    given: Any
    name: str | None


def name_parts(
    robot: Robot | None,
    built: Mapping[str, Any],
    entries: Sequence[NamedEntry],
    parts: Sequence[Any],
) -> None:
    """Give the parts of a section their names, by entries in the same order.

    A part without a name goes by its joint or frame and its type; where that repeats, it has a
    number: ankle_joint_spring, ankle_joint_spring_2.

    Args:
        robot: The robot; None where there is none.
        built: Sections that are built before, by key.
        entries: One a part.
    """
    taken = {entry.name for entry in entries} | {name for _, name in _names(built)}
    taken |= _joints(robot)
    for entry, part in zip(entries, parts, strict=True):
        name = entry.name
        if name is None:
            words = (_place(entry.given, robot), type_name(type(part)))
            default = getattr(part, "default_name", "_".join(filter(None, words)))
            plain = _OTHER.sub("_", default)
            name, number = plain, 2
            while name in taken:
                name, number = f"{plain}_{number}", number + 1
            taken.add(name)
        part.name = name


def _names(parts: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Section and name of every part that has one."""
    for key, built in parts.items():
        if key != "robot":
            several = built.values() if isinstance(built, Mapping) else built
            for part in several if isinstance(built, Mapping | tuple | list) else (built,):
                if isinstance(name := getattr(part, "name", None), str):
                    yield key, name


def _joints(robot: Robot | None) -> set[str]:
    return set() if robot is None else {joint.name for joint in robot.joints}


def _place(entry: Any, robot: Robot | None) -> str:
    """Joint, frame or path of an entry that moves; empty where there is none, or several."""
    for key in _PLACES:
        place = entry.get(key)
        if isinstance(place, list):
            place = place[0] if len(place) == 1 and place != ["all"] else None
        if isinstance(place, str) and not _is_at_rest(key, place, robot):
            return place
    return ""


def _is_at_rest(key: str, place: str, robot: Robot | None) -> bool:
    """Whether a place is a frame of the world; a part of others may mean anything by its keys."""
    if not key.startswith("frame") or robot is None:
        return False
    try:
        return int(robot.model.frames[robot.frame(place)].parentJoint) == 0
    except ModelError:
        return False


def named_entry(given: Any, where: str) -> NamedEntry:
    """An entry whose name is told from what its part is built of.

    Args:
        given: What the file holds.
        where: File and key, for the messages.

    Raises:
        SceneError: A name that is not accepted.
    """
    if not isinstance(given, Mapping) or "name" not in given:
        return NamedEntry(where, given, None)
    rest = {key: value for key, value in given.items() if key != "name"}
    return NamedEntry(where, rest, checked_name(given["name"], f"{where}.name"))


def checked_name(name: Any, where: str) -> str:
    """A name that columns, topics and messages can carry.

    Raises:
        SceneError: It is none.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise SceneError(
            f"{where}: expected a name of up to 255 letters, digits, _, - and /, without a dot, "
            f"got {name!r}"
        )
    return name


def refuse_repeated(where: str, parts: Mapping[str, Any], robot: Robot | None) -> None:
    """Refuse a name that two parts have, or a part and a joint or a free base.

    A muscle may have the name of a path, which shows nothing of its own.

    Args:
        where: The file, for the messages.
        parts: Built sections by key.
        robot: The robot; None where there is none.

    Raises:
        SceneError: Names it, and who has it.
    """
    owners = dict.fromkeys(_joints(robot), "a joint of the robot")
    if robot is not None and any(base.name == BASE for base in robot.bases):
        owners[BASE] = "the floating base"
    muscles = {part.name for part in parts.get("muscles", ())}
    for key, name in _names(parts):
        if key == "paths" and name in muscles:
            continue
        if name in owners:
            raise SceneError(f"{where}: {key}: name '{name}' is that of {owners[name]}, too")
        owners[name] = f"a part of {key}"
