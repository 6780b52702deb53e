"""Bytes of an .osim file -> its elements, also where strict XML readers refuse them."""

import re
from pathlib import Path
from xml.etree import ElementTree

from mbd_ros.errors import SceneError
from mbd_ros.scene.models.xml_text import parse_document

SUFFIXES = (".osim", ".osim.gz")


def is_osim(path: str | Path) -> bool:
    """Whether the name of a file is that of a model of OpenSim."""
    return str(path).lower().endswith(SUFFIXES)


def parse_osim(text: str, source: str) -> ElementTree.Element:
    """The `<Model>` of a document, its version as attribute `version`.

    Raises:
        SceneError: No XML, no model, or a version that is not known; names line and element.
    """
    root = parse_document(text, source)
    model = root if root.tag == "Model" else root.find("Model")
    if root.tag not in ("OpenSimDocument", "Model") or model is None:
        inner = ", ".join(child.tag for child in root) or "nothing"
        raise SceneError(
            f"{source}: expected <OpenSimDocument> with <Model>, found <{root.tag}> with {inner}"
        )
    model.set("version", _version(root, source))
    return model


def _version(root: ElementTree.Element, source: str) -> str:
    """Five digits: 10900 .. 49999."""
    text = root.get("Version", "10900")
    if not re.fullmatch("[1-4][0-9]{4}", text, re.ASCII):
        raise SceneError(f"{source}: <OpenSimDocument Version='{text}'>: accepted: 10000 .. 49999")
    return text
