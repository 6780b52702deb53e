"""Springs, limits, bushings and actuators -> the sections `forces` and `actuators`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from mbd_ros.scene.models.imported_model import Unexpressed
from mbd_ros.scene.models.osim.item import (
    Attached,
    Item,
    frame_entries,
    old_placement,
    placement,
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
_OUTWARDS = (-1.0, 0.0, 0.0)  # OpenSim's half space is where x > 0
_MOST_PAIRS = 10_000  # of shapes of a force: names may repeat, and every shape meets every other
CONTACTS = ("HuntCrossleyForce", "SmoothSphereHalfSpaceForce")


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


def contact_entries(reading: Reading, item: Item) -> list[Entry]:
    """The contacts of a force: spheres against half spaces, or spheres against one another.

    Raises:
        SceneError: Names element and what is wrong.
        Unexpressed: None of its shapes can touch.
    """
    pairs = list(_pairs(reading, item))
    if not pairs:
        raise Unexpressed("no sphere and half space on bodies that move against each other")
    velocity = item.number("transition_velocity", default=0.01)
    contacts = []
    for (a, of_a), (b, of_b) in pairs:
        name = reading.names.part(f"{item.name}_{a.name}", "contact")
        contacts.append({"name": name, **_contact(a, b, of_a, of_b, velocity)})
    left_out = _left_out_terms(item, [material for pair in pairs for _, material in pair])
    if left_out:
        reading.leave_out(item, left_out)
    return contacts


def _pairs(
    reading: Reading, item: Item
) -> Iterator[tuple[tuple[Shape, Material], tuple[Shape, Material]]]:
    """Spheres with half spaces; with one another where there is no half space."""
    surfaces = list(_surfaces(reading, item))
    planes = [one for one in surfaces if math.isinf(one[0].radius)]
    spheres = [one for one in surfaces if not math.isinf(one[0].radius)]
    pairs = itertools.product(spheres, planes) if planes else itertools.combinations(spheres, 2)
    for number, (a, b) in enumerate(pairs):
        if number == _MOST_PAIRS:
            raise item.error(f"more than {_MOST_PAIRS} pairs of shapes are not accepted")
        if reading.carriers[a[0].body] != reading.carriers[b[0].body]:
            yield a, b


def _surfaces(reading: Reading, item: Item) -> Iterator[tuple[Shape, Material]]:
    if item.type == "SmoothSphereHalfSpaceForce":
        for socket in ("sphere", "half_space"):
            yield _shape(reading, item, item.text(f"socket_{socket}")), _material(item)
        return
    tag = f"{item.type}__ContactParametersSet"
    for entry in item.objects(tag, "contact_parameters"):
        for name in entry.words("geometry"):
            yield _shape(reading, item, name), _material(entry)


def _shape(reading: Reading, item: Item, path: str) -> Shape:
    name = path.rstrip("/").split("/")[-1]
    if name not in reading.contact_geometry:
        raise item.error(f"there is no contact geometry '{name}'")
    geometry = reading.contact_geometry[name]
    frame = reading.attached(geometry, "frame", "body_name", "body")
    at = placement(geometry, ("location",), ("orientation",))
    end = Attached(frame.body, frame.at * at)
    entry: Entry = {"frame": end.body, "xyz": end.at.translation.tolist()}
    if geometry.type == "ContactSphere":
        radius = geometry.number("radius", default=0.0)
        if radius <= 0.0:
            raise Unexpressed(f"the radius of {geometry.title} is {radius:g}")
        return Shape(name, end.body, {**entry, "sphere": radius}, radius)
    if geometry.type == "ContactHalfSpace":
        normal = end.direction(_OUTWARDS)
        return Shape(name, end.body, {**entry, "half_space": normal}, math.inf)
    raise Unexpressed(f"geometry {geometry.title}")


def _material(item: Item) -> Material:
    kinds = ("static", "dynamic", "viscous")
    friction = [item.number(f"{kind}_friction", default=0.0) for kind in kinds]
    stiffness = item.number("stiffness", default=1.0)
    if stiffness <= 0.0:
        raise Unexpressed(f"its stiffness is {stiffness:g}")
    dissipation = item.number("dissipation", default=0.0)
    return Material(stiffness, dissipation, (friction[0], friction[1], friction[2]))


def _contact(a: Shape, b: Shape, of_a: Material, of_b: Material, velocity: float) -> Entry:
    """Hertz: F = 4/3 sqrt(R) k^1.5 d^1.5 (1 + 1.5 c d') with the k and c of both in series.

    Source: M. A. Sherman, A. Seth, S. L. Delp, Procedia IUTAM 2 (2011), 241-261.
    """
    soft = [material.stiffness ** (2.0 / 3.0) for material in (of_a, of_b)]
    share = soft[1] / sum(soft)  # of a in the depth
    radius = 1.0 / (1.0 / a.radius + 1.0 / b.radius)
    stiffness = 4.0 / 3.0 * math.sqrt(radius) * (soft[0] * share) ** 1.5
    dissipation = 1.5 * (share * of_a.dissipation + (1.0 - share) * of_b.dissipation)
    entry: Entry = {
        "type": "compliant",
        "between": [a.entry, b.entry],
        "law": "hunt_crossley",
    }
    entry |= {"stiffness": stiffness, "dissipation": dissipation}
    friction = [m.friction[1] for m in (of_a, of_b)]
    if all(friction):
        shared = 2.0 * friction[0] * friction[1] / sum(friction)
        entry |= {"friction": shared, "creep": velocity}
    return entry


def _left_out_terms(item: Item, materials: list[Material]) -> str:
    """Return the terms of the contact law that a scene cannot express."""
    missing = []
    if any(m.friction[0] != m.friction[1] for m in materials):
        missing.append("static friction")
    if any(m.friction[2] for m in materials):
        missing.append("viscous friction")
    if item.type != CONTACTS[0]:
        missing.append("its smoothing")
    return f"is there without {', '.join(missing)}" if missing else ""


class Shape(NamedTuple):
    """A contact geometry.

    Attributes:
        body: The body that carries it.
        entry: As a scene writes it.
        radius: Of a sphere [m], inf of a half space.
    """

    name: str
    body: str
    entry: Entry
    radius: float


class Material(NamedTuple):
    """How a geometry gives way, in the numbers of the file.

    Attributes:
        stiffness: The K of half a contact [Pa].
        dissipation: The c [s/m].
        friction: Static, dynamic [-] and viscous [s/m] coefficients.
    """

    stiffness: float
    dissipation: float
    friction: tuple[float, float, float]


def _bushing_end(reading: Reading, item: Item, i: int) -> Attached:
    """A frame, or a body and a place on it before 4.0."""
    frame = reading.attached(item, f"frame{i}", f"frame_{i}", f"body_{i}", f"body{i}")
    at = old_placement(item, (f"location_body_{i}",), (f"orientation_body_{i}",))
    return Attached(frame.body, frame.at * at)


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
