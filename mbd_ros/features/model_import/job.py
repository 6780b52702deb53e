"""Conversion of a model of OpenSim or MuJoCo to a URDF, a scene and a list of omissions."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from mbd_ros.files.output_folder import comment_line, file_stem, write_files
from mbd_ros.scene.models.imported_model import Imported
from mbd_ros.scene.models.model_entry import brought_sections, format_of, import_model
from mbd_ros.scene.models.urdf_text import plain
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.reader import build_scene
from mbd_ros.scene.schema.strict_yaml import mapping_of

_WIDTH = 140


def import_opensim(model: Path, folder: Path) -> Iterator[str]:
    """Write <name>.urdf, <name>.yaml and <name>.left_out.txt; all of them, or none.

    Args:
        model: File of the model; it is read as a model of OpenSim unless its name is that of an
            MJCF.
        folder: Folder of the files, which is created if it is missing.

    Yields:
        Lines about the files and about omissions.

    Raises:
        SceneError: The model cannot be read; the message names file and element.
        DataError: The files cannot be written.
    """
    imported = import_model(model, format_of(model) or "osim", {})
    name = file_stem(plain(imported.name))
    sections, absent = brought_sections(imported)
    lines = [*absent, *map(str, imported.left_out)]
    text = scene_text(imported, f"{name}.urdf", sections, model.name)
    build_scene(Origin(description=imported.urdf), _entries_of(text, folder / f"{name}.yaml"))
    files = {
        f"{name}.urdf": imported.urdf,
        f"{name}.yaml": text,
        f"{name}.left_out.txt": "".join(f"{line}\n" for line in lines),
    }
    write_files(folder, {name: text.encode() for name, text in files.items()})
    yield f"{folder / f'{name}.yaml'}: {', '.join(f'{k} {len(v)}' for k, v in sections.items())}"
    yield from (f"left out: {line}" for line in lines or ["nothing"])


def scene_text(imported: Imported, urdf: str, sections: Mapping[str, Any], source: str) -> str:
    """Return the scene as YAML.

    Args:
        imported: The converted model.
        urdf: File of the description, in the folder of the scene.
        sections: Sections of the scene.
        source: File of the model.
    """
    entries = {"robot": {"urdf": urdf, **imported.robot}, **sections}
    text = yaml.safe_dump(
        entries, sort_keys=False, default_flow_style=None, width=_WIDTH, allow_unicode=True
    )
    return comment_line(f"{imported.name}, from {source}.") + text


def _entries_of(text: str, path: Path) -> dict[str, Any]:
    """Return the entries of a scene as its reader gets them, without the description."""
    entries = mapping_of(text, str(path))
    del entries["robot"]["urdf"]
    return entries
