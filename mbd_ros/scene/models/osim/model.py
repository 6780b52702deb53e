"""A model of OpenSim -> a robot description and the sections of a scene."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree import ElementTree

from mbd_ros.errors import SceneError
from mbd_ros.scene.models.imported_model import NO_PLACE, Imported, Unexpressed, parse_document
from mbd_ros.scene.models.osim.constraints import (
    Coupled,
    read_constraints,
    read_couplers,
    read_prescribed,
)
from mbd_ros.scene.models.osim.forces import CONTACTS, contact_entries, force_entry
from mbd_ros.scene.models.osim.item import GROUND, Frames, Item, bodies_of, six_digits
from mbd_ros.scene.models.osim.joints import Coordinate, read_joints
from mbd_ros.scene.models.osim.mechanism import Mechanism, in_tree_order, open_loops, share_masses
from mbd_ros.scene.models.osim.muscles import is_muscle, muscle_entry
from mbd_ros.scene.models.osim.paths import read_path
from mbd_ros.scene.models.osim.reading import FORCES, Reading
from mbd_ros.scene.models.urdf_text import Mass, joint_titles, urdf_text

_READ = ("Frame", "Station", "Body", "Joint", "Constraint", *FORCES)
GRAVITY = (0.0, -9.80665, 0.0)  # m/s^2, OpenSim's default
_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
_NONE = (0.0,) * 6


def import_osim(
    text: str, source: str, locked: Mapping[str, float | None] | None = None
) -> Imported:
    """Read a model of any format from 1.9 on.

    Args:
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
    opened = open_loops(loops, frames.bodies)
    joints += opened.joints
    mechanism = Mechanism(joints, (*frames.bodies, *opened.halves))
    coupled = read_couplers(model, mechanism.coordinates, mechanism.follows, locked or {})
    reading = Reading(model, frames, mechanism, coupled.fixed, opened.closures)
    reading.left_out += coupled.left_out
    for joint in joints:
        if joint.missing:
            reading.leave_out(joint.item, joint.missing)
    for coordinate in mechanism.unused:
        reading.leave_out(coordinate.item, "moves nothing")
    titles = joint_titles(mechanism.links, mechanism.joints)
    masses = {body.name: mass_of(body) for body in bodies_of(model)}
    masses.pop(GROUND, None)
    masses = share_masses(masses, opened.halves)
    name = model.name or "model"
    return Imported(
        name,
        urdf_text(name, mechanism.links, mechanism.joints, masses, titles),
        _robot(model, mechanism, coupled, titles, masses.values()),
        _sections(reading, mechanism, coupled),
        tuple(reading.left_out),
    )


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
        sections["couplings"][name] = {"parent": parent, **function.entry}
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


def _leave_out_others(reading: Reading) -> None:
    """Note what a scene has no place for: controllers, probes, components of other types."""
    for tag in ("ControllerSet", "ProbeSet", "AnalysisSet"):
        for item in reading.model.objects(tag):
            reading.leave_out(item, NO_PLACE)
    for tag in ("components", "ComponentSet"):
        for item in reading.model.objects(tag):
            if not item.type.endswith(_READ):
                reading.leave_out(item, NO_PLACE)


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


def _initial(
    reading: Reading, coordinates: Mapping[str, Coordinate], coupled: Coupled
) -> dict[str, Any]:
    there = reading.joints - {*coupled.follows, *coupled.fixed}
    free = [one for name, one in coordinates.items() if name in there]
    position = {one.name: one.default for one in free if one.default}
    velocity = {one.name: one.speed for one in free if one.speed}
    initial = {"position": position, "velocity": velocity}
    return {key: values for key, values in initial.items() if values}
