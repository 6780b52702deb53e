"""Spheres and half spaces that press on each other -> the section `contacts`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from mbd_ros.scene.models.imported_model import Unexpressed
from mbd_ros.scene.models.osim.item import Attached, Item, placement
from mbd_ros.scene.models.osim.reading import Reading

Entry = dict[str, Any]
_OUTWARDS = (-1.0, 0.0, 0.0)  # OpenSim's half space is where x > 0
CONTACTS = ("HuntCrossleyForce", "SmoothSphereHalfSpaceForce")


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
    entry: Entry = {"frame": end.body, "xyz": end.at.translation.tolist()}
    if given.type == "ContactSphere":
        radius = given.number("radius", default=0.0)
        if radius <= 0.0:
            raise Unexpressed(f"the radius of {given.title} is {radius:g}")
        return Shape(name, end.body, {**entry, "sphere": radius}, radius)
    if given.type == "ContactHalfSpace":
        normal = end.direction(_OUTWARDS)
        return Shape(name, end.body, {**entry, "half_space": normal}, math.inf)
    raise Unexpressed(f"geometry {given.title}")


def _material(item: Item) -> Material:
    kinds = ("static", "dynamic", "viscous")
    friction = [item.number(f"{kind}_friction", default=0.0) for kind in kinds]
    stiffness = item.number("stiffness", default=1.0)
    if stiffness <= 0.0:
        raise Unexpressed(f"its stiffness is {stiffness:g}")
    dissipation = item.number("dissipation", default=0.0)
    return Material(stiffness, dissipation, (friction[0], friction[1], friction[2]))


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
