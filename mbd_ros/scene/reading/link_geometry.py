"""The `<collision>` and `<visual>` elements of a link -> shapes as a scene writes them."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from mbd_ros.core.model.robot import Recipe, Robot
from mbd_ros.core.model.robot_reader import root_link
from mbd_ros.core.model.urdf import parse_urdf
from mbd_ros.core.ranges import LARGEST
from mbd_ros.errors import SceneError
from mbd_ros.scene.schema.locate import find_file

_KINDS = "box, sphere, cylinder, capsule, mesh"


class Collision(NamedTuple):
    """One geometry of a link.

    Attributes:
        kind: As scenes call it.
        size: Its sizes, as scenes write them.
        xyz: Its place on the link [m].
        rpy: Its axes there [rad].
    """

    kind: str
    size: Any
    xyz: list[float]
    rpy: list[float]


def collisions_of(robot: Robot, name: str, where: str) -> list[Collision]:
    """All collision geometries of a link.

    Args:
        name: Of the link, as the scene calls it.
        where: File and key, for the messages.

    Raises:
        SceneError: The link has none, or one that is not understood; names it.
    """
    having = list[str]()
    for recipe in robot.recipes:
        tree = parse_urdf(recipe.text, recipe.source)
        for link in tree.findall("link"):
            known = names_of_link(recipe, tree, link.get("name", ""))
            elements = link.findall("collision")
            if name in known and elements:
                texts = enumerate(elements)
                return [
                    geometry_of(recipe, one, f"{where}: {name}: <collision> {i}")
                    for i, one in texts
                ]
            having += known[:1] if elements else []
        if recipe.shape is not None:
            having.append(recipe.name)
    found = ", ".join(having) or "none has one"
    raise SceneError(
        f"{where}: link '{name}' has no <collision>; with one or a shape: {found}; or give the "
        f"shape here, such as {{frame: {name}, sphere: 0.1}}"
    )


def names_of_link(recipe: Recipe, tree: ElementTree.Element, link: str) -> list[str]:
    """What a link is called in the scene; the root goes by the name of its member, too."""
    is_root = bool(recipe.name) and link == root_link(tree)
    return [recipe.name, recipe.scoped(link)] if is_root else [recipe.scoped(link)]


def geometry_of(recipe: Recipe, element: ElementTree.Element, where: str) -> Collision:
    """The geometry of a `<collision>` or `<visual>` element.

    Args:
        recipe: What the element is from.
        where: File and key, for the messages.

    Raises:
        SceneError: It is not understood, or names a package that is not installed.
    """
    origin, geometry = element.find("origin"), element.find("geometry")
    xyz = _numbers(origin, "xyz", "0 0 0", 3, where)
    rpy = _numbers(origin, "rpy", "0 0 0", 3, where)
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None:
        raise SceneError(f"{where}: has no geometry, accepted: {_KINDS}")
    if shape.tag == "box":
        return Collision("box", _numbers(shape, "size", "", 3, where), xyz, rpy)
    if shape.tag == "sphere":
        return Collision("sphere", _numbers(shape, "radius", "", 1, where)[0], xyz, rpy)
    if shape.tag in ("cylinder", "capsule"):
        sizes = {key: _numbers(shape, key, "", 1, where)[0] for key in ("radius", "length")}
        return Collision(shape.tag, sizes, xyz, rpy)
    if shape.tag != "mesh" or not shape.get("filename"):
        raise SceneError(f"{where}: geometry <{shape.tag}>, accepted: {_KINDS} with its filename")
    name = shape.get("filename", "").removeprefix("file://")
    file = find_file(Path(recipe.source).parent, name, where)
    scale = _numbers(shape, "scale", "1 1 1", 3, where)
    return Collision("mesh", {"file": str(file), "scale": scale}, xyz, rpy)


def _numbers(
    element: ElementTree.Element | None, key: str, default: str, count: int, where: str
) -> list[float]:
    text = default if element is None else element.get(key, default)
    values = list(_finite(text))
    if len(values) != count:
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise SceneError(f"{where}: {key}='{text}', expected {expected}")
    return values


def _finite(text: str) -> Iterator[float]:
    for word in text.split():
        try:
            value = float(word)
        except ValueError:
            return
        if not math.isfinite(value) or abs(value) > LARGEST:
            return
        yield value
