"""Models that bring sections of a scene: `robot: {osim: FILE}`, `robot: {mjcf: FILE}`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_ros.scene.origin import Model, Origin
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file
from mbd_ros.scene.schema.sections import SECTIONS, keys
from mbd_ros.scene.schema.strict_yaml import read_mapping

if TYPE_CHECKING:
    from mbd_ros.scene.models.imported_model import Imported

_ENDINGS = {"osim": (".osim", ".osim.gz"), "mjcf": (".xml", ".mjcf")}
FORMATS = tuple(_ENDINGS)
Entries = Mapping[str, Any]


def with_model(origin: Origin, entries: Entries) -> tuple[Origin, Entries]:
    """Entries with those that the model of their robot brings; their own win by name.

    Args:
        origin: Where they come from; its model is what an earlier call brought into them.

    Raises:
        SceneError: Names file, element and what is wrong.
    """
    robot = entries.get("robot")
    form = _named(robot)
    if not form:
        return origin, entries
    if origin.model is not None and origin.model.brought.get("robot") == robot:
        return origin, entries
    changes = _without(entries, {} if origin.model is None else origin.model.brought)
    where = f"{origin.name}: robot"
    file, imported = _imported(origin, robot, where, form)
    brought, absent = brought_sections(imported)
    merged = {**changes, "robot": _merged_robot(imported.robot, robot, "gravity" in entries)}
    for key, entry in brought.items():
        merged[key] = _merged(entry, changes.get(key), f"{origin.name}: {key}")
    lines = (*absent, *_grouped(imported))
    brought["robot"] = merged["robot"]
    return origin._replace(model=Model(file, imported.urdf, brought, lines)), merged


def _named(robot: Any) -> str:
    """The format of the model that a robot names, empty without one."""
    entry = robot if isinstance(robot, dict) else {}
    return next((key for key in FORMATS if entry.get(key) is not None), "")


def _without(entries: Entries, brought: Entries) -> dict[str, Any]:
    """Entries without those that a model brought before."""
    result = dict(entries)
    for key, before in brought.items():
        entry = result.get(key)
        if key == "robot" or entry is None:
            continue
        if isinstance(before, dict):
            kept = {k: v for k, v in entry.items() if k not in before or before[k] != v}
        else:
            kept = [one for one in entry if one not in before]
        result[key] = kept or None
    return {key: entry for key, entry in result.items() if entry is not None}


def _imported(origin: Origin, robot: Entries, where: str, form: str) -> tuple[str, Imported]:
    name = schema.value(robot[form], str, f"{where}.{form}")
    file = find_file(origin.folder, name, f"{where}.{form}")
    locked = schema.value(robot.get("locked") or {}, Mapping[str, float | None], f"{where}.locked")
    return str(file), import_model(file, form, locked)


def import_model(path: Path, form: str, locked: Mapping[str, float | None]) -> Imported:
    """Read a model.

    Args:
        form: One of `FORMATS`.
        locked: Joint -> position [rad or m] where it is locked, None where the file locks it and
            it is to move.

    Raises:
        SceneError: Names file, element and what is wrong.
    """
    if form == "mjcf":
        from mbd_ros.scene.models.mjcf.model import import_mjcf

        return import_mjcf(path, locked)
    from mbd_ros.scene.models.imported_model import read_text
    from mbd_ros.scene.models.osim.model import import_osim

    return import_osim(read_text(path), str(path), locked)


def brought_sections(imported: Imported) -> tuple[dict[str, Any], list[str]]:
    """Sections of a model that a scene has, and what is left out of them."""
    known = set(keys(SECTIONS))
    brought = {key: entry for key, entry in imported.sections.items() if key in known}
    absent = [f"section {key}" for key in imported.sections if key not in known]
    return brought, absent


def _merged_robot(brought: Entries, entry: Entries, has_gravity: bool) -> dict[str, Any]:
    robot = {**brought, **entry}
    for key in ("locked", "rename"):
        both = {**brought.get(key, {}), **(entry.get(key) or {})}
        robot[key] = {name: value for name, value in both.items() if value is not None}
    if has_gravity and "gravity" not in entry:
        del robot["gravity"]
    return {key: value for key, value in robot.items() if value != {}}


def _merged(brought: Any, scene_entry: Any, where: str) -> Any:
    """A section of a model with the entries of a scene, which win where names are the same."""
    if scene_entry is None:
        return brought
    if isinstance(brought, dict):
        scene_entry = schema.value(scene_entry, Mapping[str, Any], where)
        inner = {
            key: {**brought[key], **scene_entry[key]}
            for key in brought.keys() & scene_entry.keys()
            if where.endswith("initial") and isinstance(scene_entry[key], dict)
        }
        return {**brought, **scene_entry, **inner}
    scene_entry = schema.value(scene_entry, Sequence[Any], where)
    names = {entry.get("name") for entry in scene_entry if isinstance(entry, dict)}
    return [*(entry for entry in brought if entry.get("name") not in names), *scene_entry]


def _grouped(imported: Imported) -> list[str]:
    """Left-outs of a kind in one line."""
    groups: dict[tuple[str, str], list[str]] = {}
    for one in imported.left_out:
        groups.setdefault((one.type, one.reason), []).append(one.name)
    return [
        f"{kind} {', '.join(name or '-' for name in names)} ({reason})"
        for (kind, reason), names in groups.items()
    ]


def entries_of(path: Path) -> dict[str, Any]:
    """The entries of a scene file, or those of a scene that is a model alone.

    Raises:
        SceneError: Names file, line and key.
    """
    found = format_of(path)
    return {"robot": {found: path.name}} if found else read_mapping(path)


def format_of(path: Path) -> str:
    """The format that the name of a file says, empty for other files."""
    name = path.name.lower()
    return next((key for key, ends in _ENDINGS.items() if name.endswith(ends)), "")
