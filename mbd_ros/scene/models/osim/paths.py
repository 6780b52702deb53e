"""Paths of muscles, springs and actuators -> the section `paths`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mbd_ros.scene.models.imported_model import Unexpressed
from mbd_ros.scene.models.osim.functions import UnknownFunction, function_in
from mbd_ros.scene.models.osim.item import Item, placement
from mbd_ros.scene.models.osim.reading import Reading
from mbd_ros.scene.models.urdf_text import Function, xyz_rpy

_EDGE = 1.0e-5  # rad or m by which OpenSim widens the range of a conditional point
_CONDITIONAL = ("ConditionalPathPoint", "MuscleViaPoint")
_MOVING = ("MovingPathPoint", "MovingMusclePoint")
_PLAIN = ("PathPoint", "MusclePoint")


def read_path(reading: Reading, owner: Item) -> dict[str, Any]:
    """The path of a muscle, spring or actuator, as `paths` has it.

    Raises:
        SceneError: Names element and what is wrong.
        Unexpressed: No path of a scene expresses it.
    """
    geometry = owner.find("GeometryPath", "path") or owner
    other = [element.type for element in owner.children() if element.type.endswith("Path")]
    if geometry is owner and other:
        raise Unexpressed(f"path {other[0]}")
    items = list(geometry.objects("PathPointSet", "MusclePointSet"))
    points = [_point(reading, element) for element in items]
    numbers = [i for i, element in enumerate(points) if element is not None]
    entry: dict[str, Any] = {"points": [points[i] for i in numbers]}
    if len(numbers) < 2:
        raise Unexpressed(f"a path of {len(numbers)} points")
    moves = {reading.carriers[point["frame"]] for point in entry["points"]}
    if len(moves) == 1 and not any("moves" in point for point in entry["points"]):
        raise Unexpressed("no joint that moves changes the length of its path")
    wraps = [
        wrap
        for element in geometry.objects("PathWrapSet", "MuscleWrapSet")
        if (wrap := _wrap(reading, element, numbers)) is not None
    ]
    if wraps:
        entry["wraps"] = wraps
    return entry


def _point(reading: Reading, item: Item) -> dict[str, Any] | None:
    """A point; None for one that is never there."""
    frame = reading.attached(item, "parent_frame", "body")
    if item.type in _MOVING:
        return _moving(reading, item, frame)
    point: dict[str, Any] = {"frame": frame.body, "xyz": frame.point(item.vector("location"))}
    if item.type in _PLAIN:
        return point
    if item.type not in _CONDITIONAL:
        raise Unexpressed(f"point {item.type}")
    lower, upper = item.vector("range", default=(0.0, 0.0), length=2)
    name = reading.coordinate(item, "coordinate", "coordinates", "coordinate_name")
    if name in reading.fixed:
        return point if lower - _EDGE <= reading.fixed[name] <= upper + _EDGE else None
    return {**point, "within": {"joint": name, "lower": lower - _EDGE, "upper": upper + _EDGE}}


def _moving(reading: Reading, item: Item, frame: Any) -> dict[str, Any]:
    """A point that slides along axes of its frame, which must be those of its body."""
    functions, joints = dict[str, Function](), list[str]()
    place = [0.0, 0.0, 0.0]
    for i, axis in enumerate("xyz"):
        function = _location(item, axis)
        names = (f"{axis}_coordinate", f"{axis}_coordinates", f"{axis.upper()}Coordinate")
        if function.constant is None:
            name = reading.coordinate(item, *names)
            if name not in reading.fixed:
                functions[axis] = function
                joints.append(name)
                continue
            place[i] = function.value(reading.fixed[name], item.where)
        else:
            place[i] = function.constant
    if not functions:
        return {"frame": frame.body, "xyz": frame.point(place)}
    if len(set(joints)) > 1:
        raise Unexpressed(f"{item.title} is moved by {' and '.join(sorted(set(joints)))}")
    if xyz_rpy(frame.at):
        raise Unexpressed(f"{item.title} moves along axes of an offset frame")
    moves = {"joint": joints[0], **{axis: dict(f.entry) for axis, f in functions.items()}}
    return {"frame": frame.body, "xyz": place, "moves": moves}


def _location(item: Item, axis: str) -> Function:
    try:
        return function_in(item.find(f"{axis}_location", f"{axis.upper()}Attachment"))
    except UnknownFunction as error:
        raise Unexpressed(f"{item.title}: {error}") from error


def _wrap(reading: Reading, item: Item, numbers: Sequence[int]) -> dict[str, Any] | None:
    """A wrap; None for one that is not active."""
    name = item.text("wrap_object")
    if name not in reading.wrap_objects:
        raise item.error(f"there is no wrap object '{name}'")
    body, surface = reading.wrap_objects[name]
    if not surface.flag("active", default=True):
        return None
    pose = xyz_rpy(_wrap_frame(surface))
    wrap: dict[str, Any] = {"name": item.name or name, "frame": body, **_wrap_shape(surface)}
    if pose:
        wrap["pose"] = pose
    side = surface.text("quadrant", default="all").lower().replace("+", "")
    wrap["side"] = "all" if side in ("unassigned", "") else side
    first, last = (int(n) for n in item.vector("range", default=(-1.0, -1.0), length=2))
    if first > 0 or last > 0:
        wrap["between"] = _between(first, last, numbers)
    if "ellipsoid" in wrap:
        wrap["method"] = item.text("method", default="hybrid")
    return wrap


def _between(first: int, last: int, numbers: Sequence[int]) -> list[int]:
    """Range of points, counted from 1, in places of those that are kept."""
    begin, end = max(first - 1, 0), (last - 1 if last > 0 else numbers[-1])
    inside = [place for place, i in enumerate(numbers) if begin <= i <= end]
    return [inside[0], inside[-1]] if inside else [0, 0]


def _wrap_frame(item: Item) -> Any:
    return placement(item, ("translation",), ("xyz_body_rotation",))


def _wrap_shape(item: Item) -> dict[str, Any]:
    if item.type == "WrapCylinder":
        sizes = {"radius": item.number("radius"), "length": item.number("length")}
        return {"cylinder": sizes}
    if item.type in ("WrapSphere", "WrapSphereObst"):
        return {"sphere": item.number("radius")}
    if item.type == "WrapEllipsoid":
        return {"ellipsoid": item.vector("dimensions", default=None)}
    if item.type == "WrapTorus":
        sizes = {"inner": item.number("inner_radius"), "outer": item.number("outer_radius")}
        return {"torus": sizes}
    raise Unexpressed(f"wrap object {item.title}")
