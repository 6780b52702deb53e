"""A model of OpenSim -> a robot description and the sections of a scene."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pinocchio as pin

from mbd_ros.errors import SceneError
from mbd_ros.scene.models.imported import Imported, Unexpressed, parse_document
from mbd_ros.scene.models.osim.constraints import placed, read_constraints
from mbd_ros.scene.models.osim.forces import (
    CONTACTS,
    contact_entries,
    force_entry,
    is_muscle,
    muscle_entry,
    read_path,
)
from mbd_ros.scene.models.osim.functions import UnknownFunction, function_in
from mbd_ros.scene.models.osim.item import GROUND, Attached, Frames, Item, bodies_of, six_digits
from mbd_ros.scene.models.osim.joints import (
    Coordinate,
    Coupled,
    Joint,
    Mechanism,
    entry_of,
    in_tree_order,
    read_couplers,
    read_joints,
    turned_round,
)
from mbd_ros.scene.models.osim.reading import FORCES, Reading
from mbd_ros.scene.models.urdf_text import Mass, Names, urdf_text

# Joints that close loops: a body is cut in two halves that a constraint holds together.

_DIRECT = {"WeldJoint": "full", "BallJoint": "point"}  # which need no second half


class Cut(NamedTuple):
    """Loops that are open.

    Attributes:
        joints: Joints to the second halves, in the order of the file.
        halves: Name of a second half -> the body.
        closures: Name of a joint -> the constraint that closes its loop.
    """

    joints: list[Joint]
    halves: dict[str, str]
    closures: dict[str, dict[str, Any]]


def cut(loops: Sequence[Joint], taken: Sequence[str]) -> Cut:
    """Open loops at the children of the joints that close them.

    Args:
        loops: The joints.
        taken: Names that links have.
    """
    found, names = Cut([], {}, {}), Names(taken)
    for given in loops:
        joint = turned_round(given) if given.child.body == GROUND else given
        closure: dict[str, Any] = {"type": "loop_closure"}
        if joint.item.type in _DIRECT:
            closure["kind"] = _DIRECT[joint.item.type]
            closure |= placed("a", joint.parent) | placed("b", joint.child)
        else:
            half = names.take(f"{joint.child.body}_{joint.name}")
            found.halves[half] = joint.child.body
            found.joints.append(joint._replace(child=Attached(half, joint.child.at)))
            whole, other = (
                Attached(name, pin.SE3.Identity()) for name in (joint.child.body, half)
            )
            closure |= {"kind": "full"} | placed("a", whole) | placed("b", other)
        found.closures[joint.name] = closure
    return found


def shared(masses: dict[str, Mass], halves: dict[str, str]) -> dict[str, Mass]:
    """Masses with each body that is cut shared evenly by its parts."""
    found = dict(masses)
    for body in set(halves.values()):
        parts = [body, *(half for half, whole in halves.items() if whole == body)]
        whole = masses[body]
        moments = [moment / len(parts) for moment in whole.moments]
        found |= dict.fromkeys(parts, Mass(whole.mass / len(parts), whole.centre, moments))
    return found


# Coordinates that functions of time prescribe -> constraints `prescribed_motion`.


def read_prescribed(
    reading: Reading, coordinates: Mapping[str, Coordinate], coupled: Iterable[str]
) -> list[dict[str, Any]]:
    """The motions of coordinates that do not stand still.

    Args:
        reading: The model.
        coordinates: By name.
        coupled: Those that follow others.

    Raises:
        SceneError: Names coordinate and what is wrong.
    """
    found = []
    for name, coordinate in coordinates.items():
        is_free = name in reading.joints and name not in reading.fixed and name not in coupled
        if is_free and coordinate.item.flag("prescribed"):
            try:
                motion = _motion(coordinate.item)
            except Unexpressed as error:
                reading.leave_out(coordinate.item, str(error))
                continue
            title = reading.names.part(f"{name}_motion", "motion")
            found.append({"name": title, "type": "prescribed_motion", "joint": name, **motion})
    return found


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


# Bytes of an .osim file -> its elements, also where strict XML readers refuse them.

SUFFIXES = (".osim", ".osim.gz")


def is_osim(path: str | Path) -> bool:
    """Whether the name of a file is that of a model of OpenSim."""
    return str(path).lower().endswith(SUFFIXES)


def parse_osim(text: str, source: str) -> ElementTree.Element:
    """The `<Model>` of a document, its version as attribute `version`.

    Raises:
        SceneError: No XML, no model, or a version that is not known; names line and element.
    """
    root = parse_document(text, source)
    model = root if root.tag == "Model" else root.find("Model")
    if root.tag not in ("OpenSimDocument", "Model") or model is None:
        inner = ", ".join(child.tag for child in root) or "nothing"
        raise SceneError(
            f"{source}: expected <OpenSimDocument> with <Model>, found <{root.tag}> with {inner}"
        )
    model.set("version", _version(root, source))
    return model


def _version(root: ElementTree.Element, source: str) -> str:
    """Five digits: 10900 .. 49999."""
    text = root.get("Version", "10900")
    if not re.fullmatch("[1-4][0-9]{4}", text, re.ASCII):
        raise SceneError(f"{source}: <OpenSimDocument Version='{text}'>: accepted: 10000 .. 49999")
    return text


# Markers -> the section `sensors`.


def read_markers(reading: Reading) -> dict[str, Any]:
    """The markers of a model by name; `label` is what files of markers call them.

    Raises:
        SceneError: Names marker and what is wrong.
    """
    sensors: dict[str, Any] = {}
    for item in reading.model.objects("MarkerSet"):
        frame = reading.attached(item, "parent_frame", "body")
        name = reading.names.part(item.name, "marker")
        entry = {
            "type": "marker",
            "frame": frame.body,
            "xyz": frame.point(item.vector("location")),
        }
        if name != item.name:
            entry["label"] = item.name
        if item.flag("fixed"):
            entry["fixed"] = True
        sensors[name] = entry
    return sensors


# Masses and moments of inertia of the bodies of a model.

_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
_NONE = (0.0,) * 6


def mass_of(body: Item) -> Mass:
    """Mass of a `<Body>` of any format.

    Raises:
        SceneError: Names body and element.
    """
    if body.find("inertia") is not None:
        moments = body.vector("inertia", default=_NONE, length=6)
    else:
        tags = [f"inertia_{key}" for key in _MOMENTS]  # before 4.0
        moments = [six_digits(body.number(tag, default=0.0)) for tag in tags]
    return Mass(body.number("mass", default=0.0), body.vector("mass_center"), moments)


_READ = ("Frame", "Station", "Body", "Joint", "Constraint", *FORCES)
_NO_PLACE = "a scene has no place for it"
GRAVITY = (0.0, -9.80665, 0.0)  # m/s^2, OpenSim's default


def import_osim(
    text: str, source: str, locked: Mapping[str, float | None] | None = None
) -> Imported:
    """Read a model of any format from 1.9 on.

    Args:
        text: The file.
        source: Its name, for the messages.
        locked: Coordinate -> position [rad or m] where it is to be locked, or None where one that
            the file locks is to move.

    Raises:
        SceneError: Names file, element and what is wrong.
    """
    element = parse_osim(text, source)
    model = Item(element, source, {one.tag: one for one in element.iterfind("defaults/*")})
    frames = Frames(model)
    joints, loops = in_tree_order(read_joints(model, frames), frames, model)
    opened = cut(loops, frames.bodies)
    joints += opened.joints
    mechanism = Mechanism(joints, (*frames.bodies, *opened.halves))
    coupled = read_couplers(model, mechanism.coordinates, mechanism.follows, locked or {})
    reading = Reading(model, frames, mechanism, coupled.fixed)
    reading.left_out += coupled.left_out
    for joint in joints:
        if joint.missing:
            reading.leave_out(joint.item, joint.missing)
    for coordinate in mechanism.unused:
        reading.leave_out(coordinate.item, "moves nothing")
    titles = _titles(mechanism)
    reading.closures = opened.closures
    masses = {body.name: mass_of(body) for body in bodies_of(model)}
    masses.pop(GROUND, None)
    masses = shared(masses, opened.halves)
    name = model.name or "model"
    return Imported(
        name,
        urdf_text(name, mechanism.links, mechanism.joints, masses, titles),
        _robot(model, mechanism, coupled, titles, masses.values()),
        _sections(reading, mechanism, coupled),
        tuple(reading.left_out),
    )


def _titles(mechanism: Mechanism) -> dict[str, str]:
    """Joints that have the name of a link -> what the description calls them.

    Pinocchio tells frames by their names alone where joints are locked.
    """
    taken = Names([*mechanism.links, *(joint.name for joint in mechanism.joints)])
    links = set(mechanism.links)
    return {
        joint.name: taken.take(f"{joint.name}_joint")
        for joint in mechanism.joints
        if joint.name in links
    }


def _robot(
    model: Item,
    mechanism: Mechanism,
    coupled: Coupled,
    titles: Mapping[str, str],
    masses: Iterable[Mass],
) -> dict[str, Any]:
    robot: dict[str, Any] = {"gravity": model.vector("gravity", default=GRAVITY)}
    if any(mass.is_impossible for mass in masses):
        robot["any_inertias"] = True
    there = {joint.name for joint in mechanism.joints}
    locked = {name: value for name, value in coupled.fixed.items() if name in there}
    if locked:
        robot["locked"] = locked
    if titles:
        robot["rename"] = {title: name for name, title in titles.items()}
    return robot


def _sections(reading: Reading, mechanism: Mechanism, coupled: Coupled) -> dict[str, Any]:
    sections: dict[str, Any] = {"couplings": {}, "paths": {}, "muscles": []}
    sections |= {"forces": [], "actuators": [], "constraints": [], "contacts": []}
    for name, (parent, function) in coupled.follows.items():
        sections["couplings"][name] = entry_of(parent, function)
    for item in reading.forces():
        try:
            _add_force(reading, sections, item)
        except Unexpressed as error:
            reading.leave_out(item, str(error))
    _leave_out_others(reading)
    sections["constraints"] += read_constraints(reading)
    sections["constraints"] += read_prescribed(reading, mechanism.coordinates, coupled.follows)
    sections["sensors"] = read_markers(reading)
    sections["initial"] = _initial(reading, mechanism.coordinates, coupled)
    return {key: entries for key, entries in sections.items() if entries}


def _leave_out_others(reading: Reading) -> None:
    """Note what a scene has no place for: controllers, probes, components of other types."""
    for tag in ("ControllerSet", "ProbeSet", "AnalysisSet"):
        for item in reading.model.objects(tag):
            reading.leave_out(item, _NO_PLACE)
    for tag in ("components", "ComponentSet"):
        for item in reading.model.objects(tag):
            if not item.type.endswith(_READ):
                reading.leave_out(item, _NO_PLACE)


def _add_force(reading: Reading, sections: dict[str, Any], item: Item) -> None:
    """A muscle or another force; what has a path gets an entry in `paths`."""
    if item.type in CONTACTS:
        sections["contacts"] += contact_entries(reading, item)
        return
    if is_muscle(item):
        section, entry = "muscles", {"path": read_path(reading, item), **muscle_entry(item)}
    else:
        section, entry = force_entry(reading, item)
    name = reading.names.part(item.name, section.removesuffix("s"))
    if "path" in entry:
        title = reading.names.part(f"{name}_path", "path")
        sections["paths"][title], entry["path"] = entry["path"], title
    sections[section].append({"name": name, **entry})


def _initial(
    reading: Reading, coordinates: Mapping[str, Coordinate], coupled: Coupled
) -> dict[str, Any]:
    there = reading.joints - {*coupled.follows, *coupled.fixed}
    free = [one for name, one in coordinates.items() if name in there]
    position = {one.name: one.default for one in free if one.default}
    velocity = {one.name: one.speed for one in free if one.speed}
    initial = {"position": position, "velocity": velocity}
    return {key: values for key, values in initial.items() if values}
