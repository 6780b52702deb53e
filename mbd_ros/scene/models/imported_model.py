"""An imported model of another program: URDF, sections, and a list of what was left out.

Files of models are read leniently: in old encodings, and where strict readers of XML refuse them.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from mbd_ros.core.model.xml_tree import MarkupError, decoded, xml_tree
from mbd_ros.errors import SceneError
from mbd_ros.gzip_file import unpacked_gzip
from mbd_ros.regular_file import open_regular

NO_PLACE = "a scene has no place for it"  # a reason to leave something out
MAX_BYTES = 64 * 1024 * 1024


class Imported(NamedTuple):
    """A model as URDF and sections of a scene.

    Attributes:
        name: Of the model.
        urdf: Its bodies and joints.
        robot: Keys of the section `robot` besides the description.
        sections: The other sections.
        left_out: Elements that they do not have.
    """

    name: str
    urdf: str
    robot: dict[str, Any]
    sections: dict[str, Any]
    left_out: tuple[LeftOut, ...]


class LeftOut(NamedTuple):
    """An element that the scene does not have.

    Attributes:
        type: Its class in the other program.
        reason: Why it is left out.
    """

    type: str
    name: str
    reason: str

    def __str__(self) -> str:
        return f"{self.type} '{self.name}': {self.reason}"


class Unexpressed(SceneError):
    """An element that a scene cannot express; its message says why, for the list of left-outs."""


def read_text(path: Path) -> str:
    """Text of a model file, packed by gzip or not.

    Raises:
        SceneError: Missing, too large, or no text; names the file.
    """
    try:
        with open_regular(path) as file:
            packed = path.suffix.lower() == ".gz"
            data = (unpacked_gzip(file) if packed else file).read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{path}: model cannot be read: {reason}") from error
    if len(data) > MAX_BYTES:
        raise SceneError(f"{path}: model has more than {MAX_BYTES} bytes")
    return decoded(data)


def parse_document(text: str, source: str) -> ElementTree.Element:
    """The outermost element of a document.

    Raises:
        SceneError: No XML that is accepted; names the line.
    """
    try:
        return xml_tree(text)
    except MarkupError as error:
        raise SceneError(f"{source}: {error}") from error
