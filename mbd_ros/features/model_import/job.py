"""A model of OpenSim or MuJoCo -> a description, a scene, and a list of what they leave out."""

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
        model: The file; one that is no MJCF by its name is read as a model of OpenSim.
        folder: Where they are written; made where it is missing.

    Yields:
        What was written and left out, a line each.

    Raises:
        SceneError: The model cannot be read: names file and element.
        DataError: The files cannot be written.
    """
    imported = import_model(model, format_of(model) or "osim", {})
    name = file_stem(plain(imported.name))
    sections, absent = brought_sections(imported)
    lines = [*absent, *map(str, imported.left_out)]
    text = scene_text(imported, f"{name}.urdf", sections, model.name)
    build_scene(Origin(description=imported.urdf), _checked(text, folder / f"{name}.yaml"))
    files = {
        f"{name}.urdf": imported.urdf,
        f"{name}.yaml": text,
        f"{name}.left_out.txt": "".join(f"{line}\n" for line in lines),
    }
    write_files(folder, {name: text.encode() for name, text in files.items()})
    yield f"{folder / f'{name}.yaml'}: {', '.join(f'{k} {len(v)}' for k, v in sections.items())}"
    yield from (f"left out: {line}" for line in lines or ["nothing"])


def scene_text(imported: Imported, urdf: str, sections: Mapping[str, Any], source: str) -> str:
    """The scene as YAML.

    Args:
        urdf: File of the description, beside the scene.
        sections: Those that the scene has.
        source: File of the model.
    """
    entries = {"robot": {"urdf": urdf, **imported.robot}, **sections}
    text = yaml.safe_dump(
        entries, sort_keys=False, default_flow_style=None, width=_WIDTH, allow_unicode=True
    )
    return comment_line(f"{imported.name}, from {source}.") + text


def _checked(text: str, path: Path) -> dict[str, Any]:
    """The entries of the text as a reader gets them, the description apart."""
    entries = mapping_of(text, str(path))
    del entries["robot"]["urdf"]
    return entries
