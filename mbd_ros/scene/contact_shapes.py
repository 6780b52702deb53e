"""One side of a contact as a scene writes it -> shapes on a link."""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from mbd_ros.core.geometry.shapes import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Points,
    Shape,
    Side,
    Sphere,
)
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import WORLD, Robot
from mbd_ros.core.ranges import LARGEST, Length, Positive, Unit, Vector, Within
from mbd_ros.core.rows.pair_rows import check_normal, plane_of
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene import schema
from mbd_ros.scene.building import Site

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
    return Side(frame, (_shape(site.robot, kind, size, at, f"{where}.{kind}"),))


def _named(site: Site, name: str, where: str) -> Side:
    """The shape of a body, or the ground."""
    robot: Any = site.robot
    recipe = next((r for r in robot.recipes if r.name and r.name == name), None)
    if recipe is not None and recipe.shape is not None:
        at = robot.point(name)
        return Side(name, tuple(_shape(robot, *s, at, where) for s in (recipe.shape,)))
    if name == GROUND and not robot.model.existFrame(name):
        rest = _at_rest(robot)
        return Side(rest, (HalfSpace(robot.point(rest)),))
    known = [r.name for r in robot.recipes if r.shape is not None]
    raise SceneError(
        f"{where}: '{name}' has no shape; accepted: {', '.join((GROUND, *known))}, or a mapping "
        f"with a frame and one of {', '.join(_SHAPES)}"
    )


def _shape(robot: Any, kind: str, size: Any, at: Point, where: str) -> Shape:
    entry = size if kind in _BY_KEYS else {"size": size}
    shape: Shape = schema.call(_SHAPES[kind], entry, where, robot, at)
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


def _sphere(robot: Robot, at: Point, size: _NotNegative) -> Shape:
    return Sphere(at, size)


def _points(robot: Robot, at: Point, size: _Points) -> Shape:
    if not 1 <= len(size) <= MAX_POINTS:
        raise ModelError(f"{len(size)} points, accepted are 1 .. {MAX_POINTS}")
    return Points(at, np.array(size, dtype=np.float64))


def _box(robot: Robot, at: Point, size: _Sides) -> Shape:
    return Box(at, np.array(size, dtype=np.float64))


def _capsule(robot: Robot, at: Point, radius: _Metres, length: _Metres) -> Shape:
    return Capsule(at, radius, length)


def _cylinder(robot: Robot, at: Point, radius: _Metres, length: _Metres) -> Shape:
    return Cylinder(at, radius, length)


def _half_space(robot: Robot, at: Point, size: Vector) -> Shape:
    check_normal(size)
    return HalfSpace(plane_of(robot, at, size))


_SHAPES: Mapping[str, Callable[..., Shape]] = {
    "sphere": _sphere,
    "points": _points,
    "box": _box,
    "capsule": _capsule,
    "cylinder": _cylinder,
    "half_space": _half_space,
}
_BY_KEYS = ("capsule", "cylinder")
