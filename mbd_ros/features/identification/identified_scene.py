"""The scene that an identification found, and its files."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from mbd_ros.core.model.other_inertias import place_inertias
from mbd_ros.errors import DataError, SceneError
from mbd_ros.features.identification.friction import Column
from mbd_ros.files.replacing import replacing
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene

FRICTION = ("joint_friction", "gear_friction")  # what is found anew
_WIDTH = 140


def without_friction(scene: Scene) -> Scene:
    """The scene without the friction of its joints."""
    given = scene.entries.get("forces") or []
    kept = [entry for entry in given if entry.get("type") not in FRICTION]
    return scene if len(kept) == len(given) else scene.with_(forces=kept)


def friction_entries(
    names: Sequence[str],
    chosen: Sequence[Sequence[Column]],
    values: Sequence[Sequence[float]],
    also: Sequence[Mapping[str, float]],
) -> list[dict[str, Any]]:
    """Entries of `gear_friction`, of joints with any.

    Args:
        names: Of the joints.
        chosen: Columns of each.
        values: Of these columns.
        also: Of each the other joints that turn its motor, and their ratios.
    """
    entries = []
    for name, columns, own, others in zip(names, chosen, values, also, strict=True):
        entry: dict[str, Any] = {"type": "gear_friction", "joint": name}
        for column, value in zip(columns, own, strict=True):
            if column.term == "offset":
                entry["offset"] = -float(value)
            elif column.term == "inertia":
                entry["rotor_inertia"] = float(value)
            else:
                entry[column.term] = float(value)
            if column.smoothing:
                entry["smoothing"] = float(column.smoothing)
            if column.stribeck:
                entry["stribeck_velocity"] = float(column.stribeck)
        if len(entry) > 2:
            entry |= {"also": dict(others)} if others else {}
            entries.append(entry)
    return entries


def identified_scene(
    scene: Scene, inertias: Mapping[str, Any], friction: Sequence[Mapping[str, Any]]
) -> Scene:
    """The scene with other inertias and friction."""
    found = scene.with_inertias(inertias)
    if not friction:
        return found
    forces = [*(scene.entries.get("forces") or []), *(dict(entry) for entry in friction)]
    return found.with_(forces=forces)


def description_of(scene: Scene) -> str:
    """URDF of the only robot of a scene, its inertias written into it.

    Raises:
        SceneError: There are several robots or bodies.
    """
    recipes = scene.robot.recipes
    if len(recipes) != 1 or recipes[0].name or recipes[0].shape:
        raise SceneError(f"{scene.name}: files are written of scenes with one robot; use Python")
    tree = ElementTree.fromstring(recipes[0].text)
    place_inertias(tree, recipes[0].inertias or {}, recipes[0].source)
    return ElementTree.tostring(tree, encoding="unicode")


def scene_text(scene: Scene, urdf: str) -> str:
    """YAML of a scene whose robot is a file of that name."""
    given = scene.entries.get("robot") or {}
    kept = {k: v for k, v in given.items() if k not in ("urdf", "osim", "mjcf")}
    entries = {"robot": {"urdf": urdf, **kept}}
    entries |= {key: entry for key, entry in scene.entries.items() if key != "robot"}
    return yaml.safe_dump(entries, sort_keys=False, default_flow_style=None, width=_WIDTH)


def write_files(folder: Path, files: Mapping[str, bytes], say: Say) -> None:
    """Write files of a folder; all, or none.

    Raises:
        DataError: The folder or a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be made ({error.strerror})") from error
    with ExitStack() as stack:  # each takes its place when all are written
        for name, content in files.items():
            stack.enter_context(replacing(folder / name)).write(content)
    say(f"{folder}: {', '.join(files)}")
