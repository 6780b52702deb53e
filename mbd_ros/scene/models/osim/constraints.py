"""Constraints between bodies -> the section `constraints`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.imported_model import LeftOut, Unexpressed
from mbd_ros.scene.models.osim.functions import UnknownFunction, function_in, scaled
from mbd_ros.scene.models.osim.item import Attached, Item, frame_entries, old_placement
from mbd_ros.scene.models.osim.joints import Coordinate
from mbd_ros.scene.models.osim.mechanism import Follows
from mbd_ros.scene.models.osim.reading import Reading
from mbd_ros.scene.models.urdf_text import roll_pitch_yaw

COUPLER = "CoordinateCouplerConstraint"
Entry = dict[str, Any]
_BODIES = (("body_1", "body1"), ("body_2", "body2"))


def _point(reading: Reading, item: Item) -> Entry:
    ends = _ends(reading, item, *_BODIES)
    return {"type": "loop_closure", "kind": "point", **_points(item, ends)}


def _distance(reading: Reading, item: Item) -> Entry:
    ends = _ends(reading, item, *_BODIES)
    return {
        "type": "distance",
        **_points(item, ends),
        "distance": item.number("constant_distance"),
    }


def _line(reading: Reading, item: Item) -> Entry:
    """The follower stays on z of a frame along the line."""
    line, follower = _ends(reading, item, ("line_body",), ("follower_body",))
    along = np.array(line.direction(item.vector("line_direction_vec")))
    if not along.any():
        raise item.error("<line_direction_vec> is zero")
    return {
        "type": "loop_closure",
        "kind": "point",
        "directions": "xy",
        "frame_a": line.body,
        "point_a": line.point(item.vector("point_on_line")),
        "rpy_a": roll_pitch_yaw(_axes_along(along)),
        "frame_b": follower.body,
        "point_b": follower.point(item.vector("point_on_follower")),
    }


def _weld(reading: Reading, item: Item) -> Entry:
    entry: Entry = {"type": "loop_closure", "kind": "full"}
    ends = _ends(reading, item, ("frame1", "body_1", "body1"), ("frame2", "body_2", "body2"))
    for letter, end, i in zip("ab", ends, "12", strict=True):
        at = old_placement(item, (f"location_body_{i}",), (f"orientation_body_{i}",))
        entry |= frame_entries(letter, Attached(end.body, end.at * at))
    return entry


_READERS: Mapping[str, Callable[[Reading, Item], Entry]] = {
    "PointConstraint": _point,
    "ConstantDistanceConstraint": _distance,
    "PointOnLineConstraint": _line,
    "WeldConstraint": _weld,
}


def read_constraints(reading: Reading) -> list[Entry]:
    """The constraints of a model besides couplers of coordinates.

    Raises:
        SceneError: Names element and what is wrong.
    """
    entries = [
        {"name": reading.names.part(name, "closure"), **closure}
        for name, closure in reading.closures.items()
    ]
    for item in reading.model.components("ConstraintSet", ending="Constraint"):
        if item.type == COUPLER or not is_enforced(item):
            continue
        try:
            entry = _entry(reading, item)
        except Unexpressed as error:
            reading.leave_out(item, str(error))
            continue
        entries.append({"name": reading.names.part(item.name, "constraint"), **entry})
    return entries


def is_enforced(item: Item) -> bool:
    """Whether a constraint acts."""
    return item.flag("isEnforced", default=not item.flag("isDisabled"))


def _entry(reading: Reading, item: Item) -> Entry:
    if item.type not in _READERS:
        raise Unexpressed("no part of a scene is like it")
    return _READERS[item.type](reading, item)


def read_couplers(
    model: Item,
    coordinates: Mapping[str, Coordinate],
    joints: Mapping[str, Follows],
    locked: Mapping[str, float | None],
) -> Coupled:
    """Couplers of coordinates, and what stands still because coordinates do.

    Args:
        model: The `<Model>`.
        joints: Joints that follow a coordinate by a function of their joint.
        locked: Coordinate -> position where the scene locks it, None where it frees it.

    Raises:
        SceneError: Names coupler and what is wrong.
    """
    coupled = Coupled({}, {}, [])
    for name, coordinate in coordinates.items():
        if coordinate.locked or _prescribed_constant(coordinate) is not None:
            value = _prescribed_constant(coordinate)
            coupled.fixed[name] = coordinate.default if value is None else value
    for name, position in locked.items():
        if position is None:
            coupled.fixed.pop(name, None)
        else:
            coupled.fixed[name] = position
    for item in model.components("ConstraintSet", ending=COUPLER):
        if item.type == COUPLER and is_enforced(item):
            _add(coupled, item, coordinates)
    coupled.follows.update(joints)
    _settle(coupled, model.source)
    return coupled


def _prescribed_constant(coordinate: Coordinate) -> float | None:
    """Position of a coordinate that is prescribed to stand still."""
    if not coordinate.item.flag("prescribed"):
        return None
    try:
        function = function_in(coordinate.item.find("prescribed_function"))
    except UnknownFunction:
        return None
    return function.constant


def _add(coupled: Coupled, item: Item, coordinates: Mapping[str, Coordinate]) -> None:
    parents = item.words("independent_coordinate_names")
    child = item.text("dependent_coordinate_name")
    for name in (child, *parents):
        if name not in coordinates:
            raise item.error(f"there is no coordinate '{name}'")
    reason = ""
    if len(parents) != 1:
        reason = f"follows {len(parents)} coordinates"
    elif child in coupled.fixed:
        reason = f"'{child}' is locked"
    elif child in coupled.follows:
        reason = f"'{child}' follows '{coupled.follows[child].coordinate}' already"
    try:
        function = function_in(item.find("coupled_coordinates_function"))
    except UnknownFunction as error:
        reason = reason or str(error)
    if reason:
        coupled.left_out.append(LeftOut(item.type, item.name, reason))
        return
    scale = item.number("scale_factor", default=1.0)
    function = function if scale == 1.0 else scaled(function, scale)
    if function.constant is not None:
        coupled.fixed[child] = function.constant
    else:
        coupled.follows[child] = Follows(parents[0], function)


def _settle(coupled: Coupled, source: str) -> None:
    """Fix every coordinate that follows a fixed one."""
    settled = True
    while settled:
        settled = False
        for name, (parent, function) in list(coupled.follows.items()):
            if parent in coupled.fixed:
                coupled.fixed[name] = function.value(coupled.fixed[parent], f"{source}: {name}")
                del coupled.follows[name]
                settled = True


class Coupled(NamedTuple):
    """Fixed and dependent coordinates of a model.

    Attributes:
        follows: Coordinate -> what it follows.
        fixed: Coordinate or coupled joint -> position [rad or m] that it never leaves.
        left_out: Couplers that are not expressed.
    """

    follows: dict[str, Follows]
    fixed: dict[str, float]
    left_out: list[LeftOut]


def read_prescribed(
    reading: Reading, coordinates: Mapping[str, Coordinate], coupled: Iterable[str]
) -> list[dict[str, Any]]:
    """The motions of coordinates that do not stand still.

    Args:
        coupled: Those that follow others.

    Raises:
        SceneError: Names coordinate and what is wrong.
    """
    motions = []
    for name, coordinate in coordinates.items():
        is_free = name in reading.joints and name not in reading.fixed and name not in coupled
        if is_free and coordinate.item.flag("prescribed"):
            try:
                motion = _motion(coordinate.item)
            except Unexpressed as error:
                reading.leave_out(coordinate.item, str(error))
                continue
            title = reading.names.part(f"{name}_motion", "motion")
            motions.append({"name": title, "type": "prescribed_motion", "joint": name, **motion})
    return motions


def _motion(item: Item) -> dict[str, Any]:
    """The function of time, where `prescribed_motion` has it."""
    holder = item.find("prescribed_function")
    try:
        function = function_in(holder)
    except UnknownFunction as error:
        raise Unexpressed(f"is prescribed by a {error}") from error
    if function.slope is not None:
        return {"polynomial": [function.offset, function.slope]}
    if not {"polynomial", "spline", "harmonic"}.isdisjoint(function.entry):
        return dict(function.entry)
    raise Unexpressed(f"is prescribed by a function {next(iter(function.entry))}")


def _ends(reading: Reading, item: Item, *names: tuple[str, ...]) -> list[Attached]:
    ends = [reading.attached(item, *sockets) for sockets in names]
    reading.refuse_rigid(*ends)
    return ends


def _points(item: Item, ends: list[Attached]) -> Entry:
    entry: Entry = {}
    for letter, end, i in zip("ab", ends, "12", strict=True):
        entry[f"frame_{letter}"] = end.body
        entry[f"point_{letter}"] = end.point(item.vector(f"location_body_{i}"))
    return entry


def _axes_along(direction: Array) -> Array:
    """Axes whose z has a direction, shape (3, 3)."""
    turn = pin.Quaternion.FromTwoVectors(np.array((0.0, 0.0, 1.0)), direction)
    axes: Array = turn.toRotationMatrix()
    return axes
