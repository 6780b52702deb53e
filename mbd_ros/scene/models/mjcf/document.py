"""An MJCF file -> its elements, those of included files in their places."""

from pathlib import Path
from xml.etree.ElementTree import Element

from mbd_ros.errors import SceneError
from mbd_ros.scene.models.xml_text import parse_document, read_text

SUFFIXES = (".xml", ".mjcf")
SECTIONS = (
    *("compiler", "option", "size", "statistic", "visual", "default", "custom", "asset"),
    *("worldbody", "contact", "equality", "tendon", "actuator", "sensor", "keyframe"),
    *("extension", "deformable"),
)
MAX_FILES = 100


def is_mjcf(path: str | Path) -> bool:
    """Whether the name of a file is that of a model of MuJoCo."""
    return str(path).lower().endswith(SUFFIXES)


def read_document(path: Path) -> Element:
    """The element `<mujoco>` with what it includes.

    Raises:
        SceneError: Missing, no XML, another format, an unknown section, or an include that leads
            in a circle; names the file.
    """
    root = parse_document(read_text(path), str(path))
    if root.tag != "mujoco":
        raise SceneError(f"{path}: expected <mujoco>, found <{root.tag}>")
    _include(root, path, path.parent, [path.resolve()])
    for section in root:
        if section.tag not in SECTIONS:
            raise SceneError(
                f"{path}: unknown element <{section.tag}> in <mujoco>, accepted: "
                f"{', '.join(SECTIONS)}"
            )
    return root


def _include(element: Element, path: Path, folder: Path, seen: list[Path]) -> None:
    """Put the elements of included files in the places of `<include>`.

    Args:
        element: What may include.
        path: Its file.
        folder: That of the model, from which names of files start.
        seen: All files so far; MuJoCo takes each once.
    """
    for child in list(element):
        if child.tag != "include":
            _include(child, path, folder, seen)
            continue
        file = _file(child, path, folder)
        if file.resolve() in seen:
            raise SceneError(f"{path}: <include file='{file}'> is included before")
        if len(seen) == MAX_FILES:
            raise SceneError(f"{path}: more than {MAX_FILES} files")
        seen.append(file.resolve())
        inner = parse_document(read_text(file), str(file))
        _include(inner, file, folder, seen)
        at = list(element).index(child)
        element[at : at + 1] = list(inner)


def _file(include: Element, path: Path, folder: Path) -> Path:
    """The included file: from the folder of the model, else from that of the including file."""
    name = include.get("file", "")
    if not name:
        raise SceneError(f"{path}: <include> has no file")
    for file in (folder / name, path.parent / name):
        if file.is_file():
            return file
    raise SceneError(f"{path}: <include file='{name}'>: there is no file {folder / name}")
