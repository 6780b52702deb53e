"""Springs, limits, bushings and actuators -> the sections `forces` and `actuators`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from mbd_ros.scene.models.imported_model import Unexpressed
from mbd_ros.scene.models.osim.item import (
    Attached,
    Item,
    frame_entries,
    old_placement,
    socket,
)
from mbd_ros.scene.models.osim.paths import read_path
from mbd_ros.scene.models.osim.reading import Reading

Entry = dict[str, Any]
_DEGREE = math.pi / 180.0
_BUSHING = {  # key of the scene -> element
    "stiffness": "translational_stiffness",
    "damping": "translational_damping",
    "angular_stiffness": "rotational_stiffness",
    "angular_damping": "rotational_damping",
}


def force_entry(reading: Reading, item: Item) -> tuple[str, Entry]:
    """A force of a model: its section and its entry there.

    Raises:
        SceneError: Names element and what is wrong.
        Unexpressed: No part of a scene expresses it.
    """
    if item.type not in _READERS:
        raise Unexpressed("no part of a scene is like it")
    entry = _READERS[item.type](reading, item)
    return ("actuators" if entry["type"] == "ideal" else "forces"), entry


def _coordinate_limit(reading: Reading, item: Item) -> Entry:
    """Degrees of rotational coordinates become radians."""
    joint = _joint(reading, item)
    unit = _DEGREE if joint in reading.turning else 1.0
    numbers = {
        "lower": item.number("lower_limit", default=0.0) * unit,
        "upper": item.number("upper_limit", default=0.0) * unit,
        "lower_stiffness": item.number("lower_stiffness", default=1.0) / unit,
        "upper_stiffness": item.number("upper_stiffness", default=1.0) / unit,
        "damping": item.number("damping", default=0.001) / unit,
        "transition": item.number("transition", default=0.1) * unit,
    }
    return {"type": "soft_limit", "joint": joint, **numbers}


def _bushing(reading: Reading, item: Item) -> Entry:
    ends = [_bushing_end(reading, item, i) for i in (1, 2)]
    reading.refuse_rigid(*ends)
    entry: Entry = {"type": "bushing"}
    for letter, end in zip("ab", ends, strict=True):
        entry |= frame_entries(letter, end)
    for key, tag in _BUSHING.items():
        entry[key] = item.vector(tag)
    return {key: value for key, value in entry.items() if value != [0.0, 0.0, 0.0]}


def _bushing_end(reading: Reading, item: Item, i: int) -> Attached:
    """A frame, or a body and a place on it before 4.0."""
    frame = reading.attached(item, f"frame{i}", f"frame_{i}", f"body_{i}", f"body{i}")
    at = old_placement(item, (f"location_body_{i}",), (f"orientation_body_{i}",))
    return Attached(frame.body, frame.at * at)


def _point_spring(reading: Reading, item: Item) -> Entry:
    ends = [reading.attached(item, f"body{i}", f"body_{i}") for i in (1, 2)]
    reading.refuse_rigid(*ends)
    return {
        "type": "point_spring",
        "frame_a": ends[0].body,
        "frame_b": ends[1].body,
        "point_a": ends[0].point(item.vector("point1")),
        "point_b": ends[1].point(item.vector("point2")),
        "stiffness": item.number("stiffness", default=1.0),
        "length": item.number("rest_length", default=0.0),
    }


def _path_spring(reading: Reading, item: Item) -> Entry:
    return {
        "type": "path_spring",
        "path": read_path(reading, item),
        "stiffness": item.number("stiffness"),
        "resting_length": item.number("resting_length"),
        "dissipation": item.number("dissipation", default=0.0),
    }


def _joint_spring(reading: Reading, item: Item) -> Entry:
    return {
        "type": "joint_spring",
        "joint": _joint(reading, item),
        "stiffness": item.number("stiffness", default=0.0),
        "rest": item.number("rest_length", default=0.0),
        "damping": item.number("viscosity", default=0.0),
    }


def _coordinate_actuator(reading: Reading, item: Item) -> Entry:
    return {"type": "ideal", "joints": [_joint(reading, item)], **_limit(item)}


def _path_actuator(reading: Reading, item: Item) -> Entry:
    return {"type": "path_force", "path": read_path(reading, item), **_limit(item)}


def _between_points(reading: Reading, item: Item) -> Entry:
    if item.flag("points_are_global"):
        raise Unexpressed("its points are those of the start in ground")
    ends = [reading.attached(item, f"body{letter}") for letter in "AB"]
    reading.refuse_rigid(*ends)
    points = [
        {"frame": end.body, "xyz": end.point(item.vector(f"point{letter}"))}
        for end, letter in zip(ends, "AB", strict=True)
    ]
    return {"type": "path_force", "path": {"points": points}, **_limit(item)}


def _point_actuator(reading: Reading, item: Item) -> Entry:
    if item.flag("point_is_global"):
        raise Unexpressed("its point is fixed in ground, not on the body")
    frame = reading.attached(item, "body")
    reading.refuse_rigid(frame, None)
    is_world = item.flag("force_is_global")
    along = item.vector("direction", default=(1.0, 0.0, 0.0))
    return {
        "type": "body_force",
        "frame": frame.body,
        "point": frame.point(item.vector("point")),
        "direction": along if is_world else frame.direction(along),
        "expressed_in": "world" if is_world else "frame",
        **_limit(item),
    }


def _torque_actuator(reading: Reading, item: Item) -> Entry:
    """OpenSim turns an axis of the first body, or of ground."""
    frame = reading.attached(item, "bodyA", "body_A")
    other = reading.attached(item, "bodyB") if socket(item, "bodyB") else None
    reading.refuse_rigid(frame, other)
    is_world = item.flag("torque_is_global", default=True)
    along = item.vector("axis", default=(0.0, 0.0, 1.0))
    against = {} if other is None else {"against": other.body}
    return {
        "type": "body_force",
        "kind": "torque",
        "frame": frame.body,
        "direction": along if is_world else frame.direction(along),
        "expressed_in": "world" if is_world else "frame",
        **against,
        **_limit(item),
    }


def _joint(reading: Reading, item: Item) -> str:
    name = reading.coordinate(item, "coordinate")
    if name in reading.fixed:
        raise Unexpressed(f"'{name}' is locked")
    return name


def _limit(item: Item) -> Entry:
    """Largest force of an actuator; a range that is not even on both sides is not kept."""
    ends = [item.text(tag).lower() for tag in ("min_control", "max_control")]
    if any(not end or "inf" in end for end in ends):
        return {}
    lower, upper = item.number("min_control"), item.number("max_control")
    limit = item.number("optimal_force", default=1.0) * max(abs(lower), abs(upper))
    return {"limit": limit} if limit > 0.0 else {}


_READERS: Mapping[str, Callable[[Reading, Item], Entry]] = {
    "CoordinateLimitForce": _coordinate_limit,
    "BushingForce": _bushing,
    "PointToPointSpring": _point_spring,
    "PathSpring": _path_spring,
    "SpringGeneralizedForce": _joint_spring,
    "CoordinateActuator": _coordinate_actuator,
    "PathActuator": _path_actuator,
    "PointToPointActuator": _between_points,
    "PointActuator": _point_actuator,
    "TorqueActuator": _torque_actuator,
}
