"""Section `contacts`: pairs of shapes -> contacts."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from mbd_ros.core.geometry.shapes import (
    Between,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Mesh,
    Points,
    Shape,
    Side,
    Sphere,
)
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import WORLD, Recipe, Robot
from mbd_ros.core.model.robot_reader import root_link
from mbd_ros.core.model.urdf import parse_urdf
from mbd_ros.core.ranges import LARGEST, Length, Positive, Unit, Vector, Within
from mbd_ros.core.rows.frame_rows import check_normal, plane_of
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.part_entries import MAX_ROWS, build_section
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

# ---- contact entries --------------------------------------------------------------------------
# Section `contacts`: pairs of shapes -> contacts.


# One side of a contact as a scene writes it -> shapes on a link.

GROUND = "ground"  # the half space below the origin of the world, unless something is called so
MAX_POINTS = 200  # of one entry: as many as a scene may have rows of contacts
_Metres = Annotated[Positive, Unit("m")]
_NotNegative = Annotated[float, Within(0.0, LARGEST), Unit("m")]
_Sides = Annotated[Sequence[Positive], Length(3), Unit("m")]
_Points = Annotated[Sequence[Vector], Unit("m")]


def read_side(site: Site, given: Any, where: str) -> Side:
    """A name, or a mapping with one shape and where it stands.

    Args:
        site: Where the section is built.
        given: What the file holds.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if isinstance(given, str):
        return _named(site, given, where)
    entry = dict(schema.value(given, Mapping[str, Any], where))
    found = [key for key in _SHAPES if key in entry]
    if len(found) != 1:
        got = ", ".join(found) or ", ".join(entry) or "none"
        raise SceneError(f"{where}: expected one shape of {', '.join(_SHAPES)}, got {got}")
    (kind,) = found
    size = entry.pop(kind)
    frame, at = schema.call(_placed, entry, where, site.robot)
    return Side(frame, (_shape(site, kind, size, at, f"{where}.{kind}"),))


def _named(site: Site, name: str, where: str) -> Side:
    """The shape of a body, the ground, or what a description says of a link."""
    robot = _robot(site)
    recipe = next((r for r in robot.recipes if r.name and r.name == name), None)
    if recipe is not None and recipe.shape is not None:
        return Side(name, (_shape(site, *recipe.shape, robot.point(name), where),))
    if name == GROUND and not robot.model.existFrame(name):
        rest = _at_rest(robot)
        return Side(rest, (HalfSpace(robot.point(rest)),))
    try:
        robot.frame(name)
    except ModelError as error:
        raise SceneError(f"{where}: {error}; or {GROUND}, where nothing is called so") from error

    shapes = []
    for i, found in enumerate(collisions_of(site, name, where)):
        at = robot.point(name, found.xyz, found.rpy)
        told = f"{where}: {name}: <collision> {i}"
        shapes.append(_shape(site, found.kind, found.size, at, told))
    return Side(name, tuple(shapes))


def _robot(site: Site) -> Robot:
    assert site.robot is not None
    return site.robot


def _shape(site: Site, kind: str, size: Any, at: Point, where: str) -> Shape:
    if kind == "mesh":
        entry = size if isinstance(size, dict) else {"file": size}
        mesh: Shape = schema.call(_mesh, entry, where, site, at, where)
        return mesh
    entry = size if kind in _BY_KEYS else {"size": size}
    shape: Shape = schema.call(_SHAPES[kind], entry, where, site, at)
    return shape


def _placed(
    robot: Robot,
    *,
    frame: str | None = None,
    xyz: Vector = (0.0, 0.0, 0.0),
    rpy: Vector = (0.0, 0.0, 0.0),
) -> tuple[str, Point]:
    frame = _at_rest(robot) if frame is None else frame
    return frame, robot.point(frame, xyz, rpy)


def _at_rest(robot: Robot) -> str:
    """What the world is called; a link of that name may fly."""
    return "universe" if robot.model.existFrame(WORLD) else WORLD


def _sphere(site: Site, at: Point, size: _NotNegative) -> Shape:
    return Sphere(at, size)


def _points(site: Site, at: Point, size: _Points) -> Shape:
    if not 1 <= len(size) <= MAX_POINTS:
        raise ModelError(f"{len(size)} points, accepted are 1 .. {MAX_POINTS}")
    return Points(at, np.array(size, dtype=np.float64))


def _box(site: Site, at: Point, size: _Sides) -> Shape:
    return Box(at, np.array(size, dtype=np.float64))


def _capsule(site: Site, at: Point, radius: _Metres, length: _Metres) -> Shape:
    return Capsule(at, radius, length)


def _cylinder(site: Site, at: Point, radius: _Metres, length: _Metres) -> Shape:
    return Cylinder(at, radius, length)


def _half_space(site: Site, at: Point, size: Vector) -> Shape:
    check_normal(size)
    return HalfSpace(plane_of(_robot(site), at, size))


def _mesh(
    site: Site, at: Point, where: str, *, file: str, scale: Vector = (1.0, 1.0, 1.0)
) -> Shape:
    from mbd_ros.scene.reading.mesh_file import read_mesh

    return Mesh(at, read_mesh(find_file(site.origin.folder, file, where), scale, where))


_SHAPES: Mapping[str, Callable[..., Shape]] = {
    "sphere": _sphere,
    "points": _points,
    "box": _box,
    "capsule": _capsule,
    "cylinder": _cylinder,
    "half_space": _half_space,
    "mesh": _mesh,
}
_BY_KEYS = ("capsule", "cylinder")


def build_contacts(site: Site, entries: Any) -> Any:
    """The `contacts` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    listed = schema.value(entries, Sequence[Any], site.where)
    given = [
        entry if i in site.kept else with_shapes(site, entry, f"{site.where}[{i}]")
        for i, entry in enumerate(listed)
    ]
    parts = build_section(site, given)
    rows = sum(len(getattr(part, "rows", ())) for part in parts)
    if rows > MAX_ROWS:
        raise SceneError(f"{site.where}: {rows} rows, accepted are {MAX_ROWS}")
    return parts


def with_shapes(site: Site, given: Any, where: str) -> Any:
    """An entry whose `between` is read; what else is wrong with it is told where it is built.

    Args:
        site: Where the section is built.
        given: The entry.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if not isinstance(given, Mapping) or "between" not in given:
        return given
    sides = schema.value(given["between"], Sequence[Any], f"{where}.between")
    if len(sides) != len(Between._fields):
        raise SceneError(f"{where}.between: expected two sides, [a, b], got {len(sides)}")
    a, b = (read_side(site, side, f"{where}.between[{i}]") for i, side in enumerate(sides))
    return {**given, "between": Between(a, b)}


# ---- collision shapes -------------------------------------------------------------------------
# The `<collision>` elements of a link -> shapes as a scene writes them.


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


def collisions_of(site: Site, name: str, where: str) -> list[Collision]:
    """All collision geometries of a link.

    Args:
        site: Where the section is built.
        name: Of the link, as the scene calls it.
        where: File and key, for the messages.

    Raises:
        SceneError: The link has none, or one that is not understood; names it.
    """
    robot: Any = site.robot
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
        element: The element.
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
    file = find_file(Path(recipe.source).parent, _path(shape.get("filename", "")), where)
    scale = _numbers(shape, "scale", "1 1 1", 3, where)
    return Collision("mesh", {"file": str(file), "scale": scale}, xyz, rpy)


def _path(name: str) -> str:
    return name.removeprefix("file://")


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
