"""Section `contacts`: pairs of sides, each with shapes on a link -> contacts."""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

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
from mbd_ros.core.model.robot import WORLD, Robot
from mbd_ros.core.ranges import LARGEST, Length, Positive, Unit, Vector, Within
from mbd_ros.core.rows.frame_rows import check_normal, plane_of
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.part_entries import MAX_ROWS, build_section
from mbd_ros.scene.reading.robot_entry import collisions_of
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

GROUND = "ground"  # the half space below the origin of the world, unless something is called so
MAX_POINTS = 200  # of one entry: as many as a scene may have rows of contacts
_Metres = Annotated[Positive, Unit("m")]
_NotNegative = Annotated[float, Within(0.0, LARGEST), Unit("m")]
_Sides = Annotated[Sequence[Positive], Length(3), Unit("m")]
_Points = Annotated[Sequence[Vector], Unit("m")]


def build_contacts(site: Site, entries: Any) -> Any:
    """The `contacts` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    listed = schema.value(entries, Sequence[Any], site.where)
    with_shape = [
        entry if i in site.prebuilt else with_shapes(site, entry, f"{site.where}[{i}]")
        for i, entry in enumerate(listed)
    ]
    parts = build_section(site, with_shape)
    rows = sum(len(getattr(part, "rows", ())) for part in parts)
    if rows > MAX_ROWS:
        raise SceneError(f"{site.where}: {rows} rows, accepted are {MAX_ROWS}")
    return parts


def with_shapes(site: Site, entry: Any, where: str) -> Any:
    """An entry whose `between` is read; what else is wrong with it is told where it is built.

    Args:
        site: Where the section is built.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if not isinstance(entry, Mapping) or "between" not in entry:
        return entry
    sides = schema.value(entry["between"], Sequence[Any], f"{where}.between")
    if len(sides) != len(Between._fields):
        raise SceneError(f"{where}.between: expected two sides, [a, b], got {len(sides)}")
    a, b = (read_side(site, side, f"{where}.between[{i}]") for i, side in enumerate(sides))
    return {**entry, "between": Between(a, b)}


def read_side(site: Site, side: Any, where: str) -> Side:
    """A name, or a mapping with one shape and where it stands.

    Args:
        site: Where the section is built.
        side: What the file holds.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if isinstance(side, str):
        return _named(site, side, where)
    entry = dict(schema.value(side, Mapping[str, Any], where))
    shapes = [key for key in _SHAPES if key in entry]
    if len(shapes) != 1:
        got = ", ".join(shapes) or ", ".join(entry) or "none"
        raise SceneError(f"{where}: expected one shape of {', '.join(_SHAPES)}, got {got}")
    (kind,) = shapes
    size = entry.pop(kind)
    frame, at = schema.call(_placed, entry, where, site.robot)
    return Side(frame, (_shape(site, kind, size, at, f"{where}.{kind}"),))


def _named(site: Site, name: str, where: str) -> Side:
    """The shape of a body, the ground, or what a description says of a link."""
    robot = _robot(site)
    model_source = next((r for r in robot.model_sources if r.name and r.name == name), None)
    if model_source is not None and model_source.shape is not None:
        return Side(name, (_shape(site, *model_source.shape, robot.point(name), where),))
    if name == GROUND and not robot.model.existFrame(name):
        rest = _at_rest(robot)
        return Side(rest, (HalfSpace(robot.point(rest)),))
    try:
        robot.frame(name)
    except ModelError as error:
        raise SceneError(f"{where}: {error}; or {GROUND}, where nothing is called so") from error

    shapes = []
    for i, collision in enumerate(collisions_of(robot, name, where)):
        at = robot.point(name, collision.xyz, collision.rpy)
        told = f"{where}: {name}: <collision> {i}"
        shapes.append(_shape(site, collision.kind, collision.size, at, told))
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


def _at_rest(robot: Robot) -> str:
    """Return the name of the world; a link of that name may move freely."""
    return "universe" if robot.model.existFrame(WORLD) else WORLD


def _placed(
    robot: Robot,
    *,
    frame: str | None = None,
    xyz: Vector = (0.0, 0.0, 0.0),
    rpy: Vector = (0.0, 0.0, 0.0),
) -> tuple[str, Point]:
    frame = _at_rest(robot) if frame is None else frame
    return frame, robot.point(frame, xyz, rpy)


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
