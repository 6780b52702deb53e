"""Springs, actuators, muscles, contacts and their paths -> sections of a scene."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from mbd_ros.scene.models.imported import Unexpressed
from mbd_ros.scene.models.osim.functions import UnknownFunction, function_in
from mbd_ros.scene.models.osim.item import (
    Attached,
    Item,
    bodies_of,
    old_placement,
    placement,
    socket,
)
from mbd_ros.scene.models.osim.reading import Reading
from mbd_ros.scene.models.urdf_text import Function, roll_pitch_yaw, xyz_rpy

# ---- contacts ---------------------------------------------------------------------------------
# Spheres and half spaces that press on each other -> the section `contacts`.


ContactsEntry = dict[str, Any]
_OUTWARDS = (-1.0, 0.0, 0.0)  # OpenSim's half space is where x > 0
CONTACTS = ("HuntCrossleyForce", "SmoothSphereHalfSpaceForce")


class Shape(NamedTuple):
    """A contact geometry.

    Attributes:
        name: Its name.
        body: The body that carries it.
        entry: As a scene writes it.
        radius: Of a sphere [m], inf of a half space.
    """

    name: str
    body: str
    entry: ContactsEntry
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


def contact_entries(reading: Reading, item: Item) -> list[ContactsEntry]:
    """The contacts of a force: spheres against half spaces, or spheres against one another.

    Raises:
        SceneError: Names element and what is wrong.
        Unexpressed: None of its shapes can touch.
    """
    pairs = list(_pairs(reading, item))
    if not pairs:
        raise Unexpressed("no sphere and half space on bodies that move against each other")
    velocity = item.number("transition_velocity", default=0.01)
    found = []
    for (a, of_a), (b, of_b) in pairs:
        name = reading.names.part(f"{item.name}_{a.name}", "contact")
        found.append({"name": name, **_contact(a, b, of_a, of_b, velocity)})
    told = _told(item, [material for pair in pairs for _, material in pair])
    if told:
        reading.leave_out(item, told)
    return found


def _pairs(
    reading: Reading, item: Item
) -> Iterator[tuple[tuple[Shape, Material], tuple[Shape, Material]]]:
    """Spheres with half spaces; with one another where there is no half space."""
    given = list(_surfaces(reading, item))
    planes = [one for one in given if math.isinf(one[0].radius)]
    spheres = [one for one in given if not math.isinf(one[0].radius)]
    pairs = itertools.product(spheres, planes) if planes else itertools.combinations(spheres, 2)
    for a, b in pairs:
        if reading.carriers[a[0].body] != reading.carriers[b[0].body]:
            yield a, b


def _surfaces(reading: Reading, item: Item) -> Iterator[tuple[Shape, Material]]:
    if item.type == "SmoothSphereHalfSpaceForce":
        for socket in ("sphere", "half_space"):
            yield _shape(reading, item, item.text(f"socket_{socket}")), _material(item)
        return
    tag = f"{item.type}__ContactParametersSet"
    for given in item.objects(tag, "contact_parameters"):
        for name in given.words("geometry"):
            yield _shape(reading, item, name), _material(given)


def _material(item: Item) -> Material:
    kinds = ("static", "dynamic", "viscous")
    friction = [item.number(f"{kind}_friction", default=0.0) for kind in kinds]
    stiffness = item.number("stiffness", default=1.0)
    if stiffness <= 0.0:
        raise Unexpressed(f"its stiffness is {stiffness:g}")
    dissipation = item.number("dissipation", default=0.0)
    return Material(stiffness, dissipation, (friction[0], friction[1], friction[2]))


def _shape(reading: Reading, item: Item, path: str) -> Shape:
    name = path.rstrip("/").split("/")[-1]
    for given in reading.model.objects("ContactGeometrySet"):
        if given.name == name:
            break
    else:
        raise item.error(f"there is no contact geometry '{name}'")
    frame = reading.attached(given, "frame", "body_name", "body")
    at = placement(given, ("location",), ("orientation",))
    end = Attached(frame.body, frame.at * at)
    entry: ContactsEntry = {"frame": end.body, "xyz": end.at.translation.tolist()}
    if given.type == "ContactSphere":
        radius = given.number("radius", default=0.0)
        if radius <= 0.0:
            raise Unexpressed(f"the radius of {given.title} is {radius:g}")
        return Shape(name, end.body, {**entry, "sphere": radius}, radius)
    if given.type == "ContactHalfSpace":
        normal = end.direction(_OUTWARDS)
        return Shape(name, end.body, {**entry, "half_space": normal}, math.inf)
    raise Unexpressed(f"geometry {given.title}")


def _contact(a: Shape, b: Shape, of_a: Material, of_b: Material, velocity: float) -> ContactsEntry:
    """Hertz: F = 4/3 sqrt(R) k^1.5 d^1.5 (1 + 1.5 c d') with the k and c of both in series.

    Source: M. A. Sherman, A. Seth, S. L. Delp, Procedia IUTAM 2 (2011), 241-261.
    """
    soft = [material.stiffness ** (2.0 / 3.0) for material in (of_a, of_b)]
    share = soft[1] / sum(soft)  # of a in the depth
    radius = 1.0 / (1.0 / a.radius + 1.0 / b.radius)
    stiffness = 4.0 / 3.0 * math.sqrt(radius) * (soft[0] * share) ** 1.5
    dissipation = 1.5 * (share * of_a.dissipation + (1.0 - share) * of_b.dissipation)
    entry: ContactsEntry = {
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


def _told(item: Item, materials: list[Material]) -> str:
    """What of the law a contact of a scene does not have."""
    told = []
    if any(m.friction[0] != m.friction[1] for m in materials):
        told.append("static friction")
    if any(m.friction[2] for m in materials):
        told.append("viscous friction")
    if item.type != CONTACTS[0]:
        told.append("its smoothing")
    return f"is there without {', '.join(told)}" if told else ""


# ---- muscles ----------------------------------------------------------------------------------
# Muscles -> the section `muscles`.


_STEEPEST = math.acos(0.1)  # rad, pennation of the shortest fibre
_LEAST = 1.0e-6  # activation that muscles of a scene may have


def muscle_entry(item: Item) -> dict[str, Any]:
    """A muscle as a scene writes it, but for its path.

    Raises:
        SceneError: Names muscle and element.
        Unexpressed: Its type is not known.
    """
    kind = item.type.removesuffix("_Deprecated")
    if kind not in _TYPES:
        raise Unexpressed(f"muscle {item.type}")
    return _shared(item) | _TYPES[kind](item)


def is_muscle(item: Item) -> bool:
    """Whether an element of the force set is a muscle."""
    return "Muscle" in item.type


def _shared(item: Item) -> dict[str, Any]:
    pennation = item.number("pennation_angle_at_optimal", "pennation_angle", default=0.0)
    return {
        "max_isometric_force": item.number("max_isometric_force", default=1000.0),
        "optimal_fiber_length": item.number("optimal_fiber_length", default=0.1),
        "tendon_slack_length": item.number("tendon_slack_length", default=0.2),
        "pennation_angle": pennation,
        "max_contraction_velocity": item.number("max_contraction_velocity", "Vmax", default=10.0),
    }


def _times(item: Item, rise: float, fall: float) -> dict[str, float]:
    return {
        "activation_time": item.number("activation_time_constant", default=rise),
        "deactivation_time": item.number("deactivation_time_constant", default=fall),
    }


def _tendon(item: Item) -> str:
    return "rigid" if item.flag("ignore_tendon_compliance") else "elastic"


def _thelen(item: Item) -> dict[str, Any]:
    """OpenSim gives Thelen's muscle an elastic tendon, whatever the file says."""
    return {
        "type": "thelen",
        **_times(item, 0.015, 0.05),
        "minimum_activation": _least(item),
        "maximum_pennation_angle": item.number("maximum_pennation_angle", default=_STEEPEST),
        "tendon": "elastic",
        "tendon_strain": item.number("FmaxTendonStrain", default=0.04),
        "passive_strain": item.number("FmaxMuscleStrain", default=0.6),
        "active_shape": item.number("KshapeActive", default=0.45),
        "passive_shape": item.number("KshapePassive", default=5.0),
        "velocity_shape": item.number("Af", default=0.25),
        "lengthening_force": item.number("Flen", default=1.4),
        "fv_extrapolation": item.number("fv_linear_extrap_threshold", default=0.95),
    }


def _millard(item: Item) -> dict[str, Any]:
    """Without fibre damping OpenSim keeps the file's least force and end slopes: not expressed."""
    damps = item.flag("use_fiber_damping", default=True)
    return {
        "type": "millard",
        **_times(item, 0.01, 0.04),
        "minimum_activation": _least(item),
        "maximum_pennation_angle": item.number("maximum_pennation_angle", default=_STEEPEST),
        "tendon": _tendon(item),
        "damping": item.number("fiber_damping", default=0.1) if damps else 0.0,
        **_curves(item),
    }


def _curves(item: Item) -> dict[str, Any]:
    """Numbers of the curves that the file gives."""
    entry: dict[str, Any] = {}
    for tag, keys in _CURVES.items():
        curve = item.find(tag)
        found = {} if curve is None else {key: curve.numbers(one) for key, one in keys.items()}
        entry |= {key: numbers[0] for key, numbers in found.items() if len(numbers) == 1}
    curve = item.find("ActiveForceLengthCurve")
    if curve is not None:
        pairs = zip(_LENGTHS, (0.4441, 0.73, 1.8123), strict=True)
        entry["active_lengths"] = [curve.number(tag, default=value) for tag, value in pairs]
    return entry


def _degroote_fregly(item: Item) -> dict[str, Any]:
    if item.flag("ignore_passive_fiber_force"):
        raise Unexpressed("a fibre without passive force")
    return {
        "type": "degroote_fregly",
        **_times(item, 0.015, 0.06),
        "tendon": _tendon(item),
        "active_width": item.number("active_force_width_scale", default=1.0),
        "passive_strain": item.number("passive_fiber_strain_at_one_norm_force", default=0.6),
        "tendon_strain": item.number("tendon_strain_at_one_norm_force", default=0.049),
        "damping": item.number("fiber_damping", default=0.0),
        "activation_steepness": item.number("activation_dynamics_smoothing", default=0.1),
    }


def _least(item: Item) -> float:
    """Least activation; files that say 0 mean next to none."""
    return max(item.number("minimum_activation", default=0.01), _LEAST)


_LENGTHS = (
    "min_norm_active_fiber_length",
    "transition_norm_fiber_length",
    "max_norm_active_fiber_length",
)
_CURVES = {
    "ActiveForceLengthCurve": {"active_slope": "shallow_ascending_slope"},
    "FiberForceLengthCurve": {
        "passive_zero_strain": "strain_at_zero_force",
        "passive_strain": "strain_at_one_norm_force",
        "passive_low_stiffness": "stiffness_at_low_force",
        "passive_stiffness": "stiffness_at_one_norm_force",
        "passive_curviness": "curviness",
    },
    "TendonForceLengthCurve": {
        "tendon_strain": "strain_at_one_norm_force",
        "tendon_stiffness": "stiffness_at_one_norm_force",
        "tendon_toe_force": "norm_force_at_toe_end",
        "tendon_curviness": "curviness",
    },
    "ForceVelocityCurve": {
        "shortening_slope": "concentric_slope_near_vmax",
        "isometric_slope": "isometric_slope",
        "lengthening_slope": "eccentric_slope_near_vmax",
        "lengthening_force": "max_eccentric_velocity_force_multiplier",
        "shortening_curviness": "concentric_curviness",
        "lengthening_curviness": "eccentric_curviness",
    },
}
_TYPES: Mapping[str, Callable[[Item], dict[str, Any]]] = {
    "Thelen2003Muscle": _thelen,
    "Millard2012EquilibriumMuscle": _millard,
    "DeGrooteFregly2016Muscle": _degroote_fregly,
}


# ---- paths ------------------------------------------------------------------------------------
# Paths of muscles, springs and actuators -> the section `paths`.


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
    other = [one.type for one in owner.children() if one.type.endswith("Path")]
    if geometry is owner and other:
        raise Unexpressed(f"path {other[0]}")
    items = list(geometry.objects("PathPointSet", "MusclePointSet"))
    points = [_point(reading, one) for one in items]
    kept = [i for i, one in enumerate(points) if one is not None]
    entry: dict[str, Any] = {"points": [points[i] for i in kept]}
    if len(kept) < 2:
        raise Unexpressed(f"a path of {len(kept)} points")
    moves = {reading.carriers[point["frame"]] for point in entry["points"]}
    if len(moves) == 1 and not any("moves" in point for point in entry["points"]):
        raise Unexpressed("no joint that moves changes the length of its path")
    wraps = [
        wrap
        for one in geometry.objects("PathWrapSet", "MuscleWrapSet")
        if (wrap := _wrap(reading, one, kept)) is not None
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


def _wrap(reading: Reading, item: Item, kept: Sequence[int]) -> dict[str, Any] | None:
    """A wrap; None for one that is not active."""
    name = item.text("wrap_object")
    body, found = _wrap_object(reading, item, name)
    if not found.flag("active", default=True):
        return None
    pose = xyz_rpy(_wrap_frame(found))
    wrap: dict[str, Any] = {"name": item.name or name, "frame": body, **_paths_shape(found)}
    if pose:
        wrap["pose"] = pose
    side = found.text("quadrant", default="all").lower().replace("+", "")
    wrap["side"] = "all" if side in ("unassigned", "") else side
    first, last = (int(n) for n in item.vector("range", default=(-1.0, -1.0), length=2))
    if first > 0 or last > 0:
        wrap["between"] = _between(first, last, kept)
    if "ellipsoid" in wrap:
        wrap["method"] = item.text("method", default="hybrid")
    return wrap


def _between(first: int, last: int, kept: Sequence[int]) -> list[int]:
    """Range of points, counted from 1, in places of those that are kept."""
    begin, end = max(first - 1, 0), (last - 1 if last > 0 else kept[-1])
    inside = [place for place, i in enumerate(kept) if begin <= i <= end]
    return [inside[0], inside[-1]] if inside else [0, 0]


def _wrap_object(reading: Reading, item: Item, name: str) -> tuple[str, Item]:
    bodies = bodies_of(reading.model)
    ground = reading.model.find("Ground")
    for body in ([ground] if ground else []) + bodies:
        for found in body.objects("WrapObjectSet"):
            if found.name == name:
                return body.name or "ground", found
    raise item.error(f"there is no wrap object '{name}'")


def _wrap_frame(item: Item) -> Any:
    return placement(item, ("translation",), ("xyz_body_rotation",))


def _paths_shape(item: Item) -> dict[str, Any]:
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


# ---- forces -----------------------------------------------------------------------------------
# Springs, limits, bushings and actuators -> the sections `forces` and `actuators`.


Entry = dict[str, Any]
_DEGREE = math.pi / 180.0


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


def _joint(reading: Reading, item: Item) -> str:
    name = reading.coordinate(item, "coordinate")
    if name in reading.fixed:
        raise Unexpressed(f"'{name}' is locked")
    return name


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
        entry[f"frame_{letter}"] = end.body
        entry[f"point_{letter}"] = end.at.translation.tolist()
        entry[f"rpy_{letter}"] = roll_pitch_yaw(end.at.rotation)
    for key, tag in _BUSHING.items():
        entry[key] = item.vector(tag)
    return {key: value for key, value in entry.items() if value != [0.0, 0.0, 0.0]}


_BUSHING = {
    "stiffness": "translational_stiffness",
    "damping": "translational_damping",
    "angular_stiffness": "rotational_stiffness",
    "angular_damping": "rotational_damping",
}


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
