"""Generate the reference of embedded scenes and robots from their files and the comments there."""

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from tables import code, table

from mbd_ros.features.tools.scenes import about_scene
from mbd_ros.scene.schema.locate import embedded_scenes

ROBOTS = Path(__file__).parents[2] / "config/robots"
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)
_HEAD = """\
# Embedded scenes and robots

With this page you can look up every embedded scene, and every joint and link of the robots with
its numbers and their source. `make docs` generates it from the files in `config`.
[models.md](models.md) names the sources in full.

## Scenes
"""


def page() -> str:
    """Return the page as Markdown."""
    scenes = ((code(name), about_scene(path)) for name, path in embedded_scenes().items())
    pieces = [_HEAD, table(("scene", "shows"), scenes)]
    for path in sorted(ROBOTS.glob("*.urdf")):
        pieces += [f"## {path.stem}", *_robot(path)]
    return "\n\n".join(pieces) + "\n"


def _robot(path: Path) -> Iterator[str]:
    text = path.read_text(encoding="utf-8")
    header = _COMMENT.search(text)
    if header and header.start() < text.index("<robot"):
        yield " ".join(header[1].split())
    with_comments = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(text, ElementTree.XMLParser(target=with_comments))
    described = list(_with_comments(root))
    joints = [_joint(element, comment) for element, comment in described if element.tag == "joint"]
    moving = [row for row in joints if row[1] != "fixed"]
    if moving:
        head = ("joint", "type", "moves", "axis", "limits", "effort", "velocity", "comment")
        yield table(head, moving)
    links = [(e, comment) for e, comment in described if e.tag == "link" and _mass(e)]
    total = sum(float(_mass(link)) for link, _ in links)
    yield f"The links have {total:g} kg together; others have no mass."
    rows = ((code(link.get("name", "")), _mass(link), comment) for link, comment in links)
    yield table(("link", "mass [kg]", "comment"), rows)


def _with_comments(root: Element) -> Iterator[tuple[Element, str]]:
    """Yield the elements of a robot, each with the comment right before it."""
    comment = ""
    for child in root:
        if child.tag is ElementTree.Comment:
            comment = " ".join((child.text or "").split())
            continue
        yield child, comment
        comment = ""


def _joint(joint: Element, comment: str) -> tuple[str, ...]:
    def attribute(child: str, name: str) -> str:
        element = joint.find(child)
        return "" if element is None else element.get(name, "")

    limits = [attribute("limit", end) for end in ("lower", "upper")]
    return (
        code(joint.get("name", "")),
        joint.get("type", ""),
        code(attribute("child", "link")),
        attribute("axis", "xyz") or "1 0 0",
        " .. ".join(limits) if all(limits) else "",
        attribute("limit", "effort"),
        attribute("limit", "velocity"),
        comment,
    )


def _mass(link: Element) -> str:
    mass = link.find("inertial/mass")
    return "" if mass is None else mass.get("value", "")
