"""Entries of a file -> built sections, by the table of sections."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

from mbd_ros.core.contracts import type_name
from mbd_ros.core.model.robot import BASE, Robot
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.schema.code_permission import code_of_others, require_permission
from mbd_ros.scene.schema.sections import SECTIONS, Section, keys, ordered, parts_in

_NAME, _OTHER = re.compile(r"[\w/-]{1,255}"), re.compile(r"[^\w/-]")
# Keys that say where a part is.
_PLACES = ("joint", "joints", "frame", "frame_b", "frame_a", "path")


class Prebuilt(NamedTuple):
    """Sections and parts that need not be built again.

    Attributes:
        sections: Whole sections by key.
        parts: Parts of others: by key of the section, then as in `Site.prebuilt`.
    """

    sections: Mapping[str, Any] = MappingProxyType({})
    parts: Mapping[str, Mapping[Any, Any]] = MappingProxyType({})


def build(
    origin: Origin,
    entries: Mapping[str, Any],
    table: Sequence[Section],
    prebuilt: Prebuilt = Prebuilt(),  # noqa: B008, a constant
    scene: Scene | None = None,
) -> Built:
    """Build the sections from their entries, in the order that `after` demands.

    Args:
        origin: Where the entries come from.
        prebuilt: Sections and parts that need not be built again.
        scene: The scene that a task is asked of; None for the sections of a scene.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    parts: dict[str, Any] = {}
    robot: Robot | None = None
    for section in ordered(table):
        entry = entries.get(section.key, section.absent)
        if section.key in prebuilt.sections:
            parts[section.key] = prebuilt.sections[section.key]
        elif entry is not None:
            others = prebuilt.parts.get(section.key, {})
            site = Site(section, origin, robot, parts, others, scene)
            parts[section.key] = _builder(section)(site, entry)
        else:
            continue
        if section.key == "robot":
            robot = parts["robot"]
        elif robot is not None:
            robot = _with_armature(robot, parts_in(section, parts[section.key]))
    if scene is None:  # parts of a task have no names
        refuse_repeated(origin.name, parts, robot)
    return Built(parts, robot)


def _builder(section: Section) -> Any:
    module, _, name = section.build.partition(":")
    return getattr(importlib.import_module(module), name)


def _with_armature(robot: Robot, parts: Sequence[Any]) -> Robot:
    """The robot with the inertia that drives among the parts add to its joints."""
    drives = [part for part in parts if hasattr(part, "armature")]
    added = sum(drive.armature() for drive in drives)
    if not drives or not added.any():
        return robot
    model = robot.model.copy()
    model.armature = model.armature + added
    return replace(robot, model=model)


class Site(NamedTuple):
    """The knowledge of the builder of a section.

    Attributes:
        section: Its line of the table.
        origin: The file, or where else the entries came from.
        robot: The robot with the inertia of the drives that are built; None before it is.
        parts: The sections that are built, by key.
        prebuilt: Parts of this section that need not be built again, by their place in the list or
            by their key; a builder may build them again.
        scene: The scene that a task is asked of; None while a scene is built.
    """

    section: Section
    origin: Origin
    robot: Robot | None
    parts: Mapping[str, Any]
    prebuilt: Mapping[Any, Any] = MappingProxyType({})
    scene: Scene | None = None

    @property
    def where(self) -> str:
        """File and key, for the messages."""
        return f"{self.origin.name}: {self.section.key}"


class Built(NamedTuple):
    """Built sections.

    Attributes:
        robot: The robot with the inertia of all drives; None without a section `robot`.
    """

    parts: dict[str, Any]
    robot: Robot | None


def table_of(origin: Origin, entries: Mapping[str, Any], foreign: Mapping[str, str]) -> Table:
    """The table of the sections that a scene has, those of other packages included.

    Args:
        origin: Where the entries come from.
        foreign: As `foreign_keys` gives it.

    Raises:
        SceneError: Code of others that nobody permitted, or that is no section.
    """
    code = {**foreign, **code_of_others(entries, tuple(foreign))}
    require_permission(origin.name, code)
    return Table((*SECTIONS, *_imported(origin, foreign)), code)


class Table(NamedTuple):
    """The sections that some entries have.

    Attributes:
        sections: Those of this package, then those of others.
        code: Key -> `module:NAME` of what comes from outside this package.
    """

    sections: tuple[Section, ...]
    code: Mapping[str, str]


def _imported(origin: Origin, foreign: Mapping[str, str]) -> list[Section]:
    if not foreign:
        return []
    from mbd_ros.scene.schema.foreign_sections import import_section

    return [import_section(key, target, origin.name) for key, target in foreign.items()]


def foreign_keys(origin: Origin, entries: Mapping[str, Any]) -> dict[str, str]:
    """Key -> entry point of those sections that other packages declare; nothing is imported.

    Raises:
        SceneError: A key that nobody knows.
    """
    unknown = [key for key in entries if key not in keys(SECTIONS)]
    foreign = _declared(unknown)
    refuse_unknown(origin, [key for key in unknown if key not in foreign], SECTIONS)
    return foreign


def _declared(unknown: Sequence[str]) -> dict[str, str]:
    if not unknown:
        return {}
    from mbd_ros.scene.schema.foreign_sections import declared

    return declared(unknown)


def refuse_unknown(origin: Origin, unknown: Sequence[str], table: Sequence[Section]) -> None:
    """Refuse the first of the keys that are in no table.

    Raises:
        SceneError: Names it and what is accepted.
    """
    if unknown:
        accepted = ", ".join(keys(table))
        raise SceneError(f"{origin.name}: unknown key '{unknown[0]}', accepted: {accepted}")


def present(entries: Mapping[str, Any]) -> dict[str, Any]:
    """The entries without those that are null."""
    return {key: entry for key, entry in entries.items() if entry is not None}


class NamedEntry(NamedTuple):
    """An entry of a part.

    Attributes:
        where: File and key, for the messages.
        value: The value in the file, without the name.
        name: As given; None leaves it to `name_parts`.
    """

    where: str
    value: Any
    name: str | None


def named_entry(entry: Any, where: str) -> NamedEntry:
    """An entry whose name is told from what its part is built of.

    Args:
        entry: What the file holds.
        where: File and key, for the messages.

    Raises:
        SceneError: A name that is not accepted.
    """
    if not isinstance(entry, Mapping) or "name" not in entry:
        return NamedEntry(where, entry, None)
    rest = {key: value for key, value in entry.items() if key != "name"}
    return NamedEntry(where, rest, checked_name(entry["name"], f"{where}.name"))


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
            words = (_place(entry.value, robot), type_name(type(part)))
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
