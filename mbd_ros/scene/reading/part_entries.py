"""Sections of parts -> parts; only modules that the scene names are imported."""

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import MeasuredWrench
from mbd_ros.scene.reading.building import NamedEntry, Site, checked_name, name_parts, named_entry
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.registry import METHODS, PARTS, resolve_type, types_of
from mbd_ros.scene.schema.sections import Form, Section

if TYPE_CHECKING:
    from mbd_ros.core.kinematics.paths.paths import Path

MAX_PARTS = 1000  # in one section
MAX_ROWS = 600  # of all constraints: a solve costs their number cubed
_WORD = "[A-Za-z_][A-Za-z0-9_]*"  # of a ROS 2 name
_NAME, _TOPIC = re.compile(_WORD), re.compile(f"(~?/)?{_WORD}(/{_WORD})*")


def build_wrenches(site: Site, entries: Any) -> dict[str, MeasuredWrench]:
    """The `external_wrenches` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    wrenches = {}
    for name, entry in _named(site, entries).items():
        where = f"{site.where}.{name}"
        if not _NAME.fullmatch(str(name)):
            raise SceneError(
                f"{where}: is no ROS name, accepted: letters, digits and _, no digit first"
            )
        entry = dict(schema.value(entry, Mapping[str, Any], where))
        topic = schema.value(entry.pop("topic", None), str | None, f"{where}.topic")
        if topic is not None and not _TOPIC.fullmatch(topic):
            raise SceneError(
                f"{where}.topic: '{topic}' is no ROS topic, accepted: words of letters, digits "
                "and _, no digit first, joined by single /, perhaps after / or ~/"
            )
        load: MeasuredWrench = schema.call(MeasuredWrench, entry, where, site.robot)
        load.name, load.topic = name, topic
        wrenches[name] = load
    return wrenches


def build_paths(site: Site, entries: Any) -> "dict[str, Path]":
    """The `paths` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    from mbd_ros.scene.reading.path_entries import path_of

    paths = {}
    for name, entry in _named(site, entries).items():
        where = f"{site.where}.{name}"
        path = path_of(site.robot, entry, where)
        path.name = checked_name(name, where)
        paths[name] = path
    return paths


def build_section(site: Site, section_entry: Any) -> Any:
    """Parts of a robot by their `type`: one, a tuple of them, or a mapping by name.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if site.section.form is Form.SINGLE:
        return _named_parts(site, [named_entry(section_entry, site.where)])[0]
    if site.section.form is Form.NAMED:
        mapping = _named(site, section_entry)
        entries = [
            NamedEntry(where := f"{site.where}.{name}", entry, checked_name(name, where))
            for name, entry in mapping.items()
        ]
        return dict(zip(mapping, _named_parts(site, entries, mapping), strict=True))
    listed = schema.value(section_entry, Sequence[Any], site.where)
    _refuse_many(site, len(listed))
    entries = [named_entry(entry, f"{site.where}[{i}]") for i, entry in enumerate(listed)]
    return _named_parts(site, entries)


def build_constraints(site: Site, entries: Any) -> Any:
    """The `constraints` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    parts = build_section(site, entries)
    rows = sum(len(part.rows) for part in parts)
    if rows > MAX_ROWS:
        raise SceneError(f"{site.where}: {rows} rows, accepted are {MAX_ROWS}")
    return parts


def build_method(site: Site, entry: Any) -> Any:
    """A part that needs no robot.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    return part_of(site.section, entry, site.where)


def build_part(kind: str, entry: Any, where: str, *context: Any) -> Any:
    """The part of an entry with `type`.

    Args:
        kind: Key of the registry.
        where: File and key, for the messages.
        *context: First arguments of the part, which do not come from the YAML.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    return _typed(PARTS[kind], METHODS[kind], entry, where, context)


def _named_parts(
    site: Site, entries: Sequence[NamedEntry], keys: Iterable[str] | None = None
) -> tuple[Any, ...]:
    places = range(len(entries)) if keys is None else keys
    parts = tuple(
        site.prebuilt[place]
        if place in site.prebuilt
        else part_of(site.section, entry.value, entry.where, site)
        for place, entry in zip(places, entries, strict=True)
    )
    name_parts(site.robot, site.parts, entries, parts)
    return parts


def part_of(section: Section, entry: Any, where: str, site: Site | None = None) -> Any:
    """The part of an entry of a section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    context = () if site is None else (site.robot,)
    return _typed(types_of(section), section.offers, entry, where, context, site)


def _typed(
    types: Mapping[str, str],
    offers: Sequence[str],
    section_entry: Any,
    where: str,
    context: Sequence[Any],
    site: Site | None = None,
) -> Any:
    if isinstance(section_entry, str) and section_entry in types:
        raise SceneError(
            f"{where}: expected a mapping, got '{section_entry}': write {{type: {section_entry}}}"
        )
    entry = dict(schema.value(section_entry, Mapping[str, Any], where))
    if entry.get("type") is None:
        accepted = ", ".join((*types, "or package.module:Class"))
        raise SceneError(f"{where}: key 'type' is missing, accepted: {accepted}")
    name = entry.pop("type")
    if not inspect.isclass(name):  # Python may name a class by itself
        name = schema.value(name, str, f"{where}.type")
    part = resolve_type(types, offers, name, f"{where}.type")
    if site is not None and _takes_path(part):
        from mbd_ros.scene.reading.path_entries import with_paths

        entry = with_paths(part, entry, where, site.robot, site.parts.get("paths", {}))
    if site is not None and _takes_file(part):
        from mbd_ros.scene.reading.learned_entries import with_files

        entry = with_files(part, entry, where, site.origin.folder)
    return schema.call(part, entry, where, *context)


def _takes_path(part: Any) -> bool:
    """Whether a class may have an argument that is a path, as the texts of its hints say."""
    hints = getattr(part.__init__, "__annotations__", {}).values()
    return any(isinstance(hint, str) or "Path" in str(hint) for hint in hints)


def _takes_file(part: Any) -> bool:
    """Whether a class has an argument that is the contents of a file."""
    hints = getattr(part.__init__, "__annotations__", {}).values()
    return any("LearnedFile" in str(hint) for hint in hints)


def _named(site: Site, entry: Any) -> Mapping[str, Any]:
    entries: Mapping[str, Any] = schema.value(entry, Mapping[str, Any], site.where)
    _refuse_many(site, len(entries))
    return entries


def _refuse_many(site: Site, number: int) -> None:
    if number > MAX_PARTS:
        raise SceneError(f"{site.where}: {number} entries, accepted are {MAX_PARTS}")
