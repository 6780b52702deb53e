"""Constraints between bodies -> the section `constraints`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.imported_model import Unexpressed
from mbd_ros.scene.models.osim.couplings import COUPLER, is_enforced
from mbd_ros.scene.models.osim.item import Attached, Item, frame_entries, old_placement
from mbd_ros.scene.models.osim.reading import Reading
from mbd_ros.scene.models.urdf_text import roll_pitch_yaw

Entry = dict[str, Any]
_BODIES = (("body_1", "body1"), ("body_2", "body2"))


def read_constraints(reading: Reading) -> list[Entry]:
    """The constraints of a model besides couplers of coordinates.

    Raises:
        SceneError: Names element and what is wrong.
    """
    found = [
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
        found.append({"name": reading.names.part(item.name, "constraint"), **entry})
    return found


def _entry(reading: Reading, item: Item) -> Entry:
    if item.type not in _READERS:
        raise Unexpressed("no part of a scene is like it")
    return _READERS[item.type](reading, item)


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


_READERS: Mapping[str, Callable[[Reading, Item], Entry]] = {
    "PointConstraint": _point,
    "ConstantDistanceConstraint": _distance,
    "PointOnLineConstraint": _line,
    "WeldConstraint": _weld,
}
