"""URDF text -> a checked XML tree: strict numbers, a sound tree, masses that can exist.

`parse_urdf` refuses what cannot be read in one way only; `check_inertias` refuses masses and
moments that no body has, and names those in doubt; the other functions read a checked tree.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.xml_tree import MarkupError, xml_tree
from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

MAX_CHARACTERS = 16 * 1024 * 1024
MAX_NAME = 255
MAX_JOINTS = 300  # that move: a Data of Pinocchio takes 32 bytes times the cube of nv, 0.9 GB
MAX_LINKS = 1000  # Pinocchio's URDF reader overflows the stack on chains of a few thousand
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WITHOUT_RANGE = "limit"  # 1e308 stands for no limit in many files
_SHORTEST_AXIS = 1.0e-9
_NUMERIC_ATTRIBUTES = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": {"ixx": 1, "ixy": 1, "ixz": 1, "iyy": 1, "iyz": 1, "izz": 1},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "dynamics": {"damping": 1, "friction": 1},
}
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_ROUNDED = 1.0e-3  # of the largest moment: published tensors have three digits, turned they mix
_POINT = 1.0e-8  # m^2: a tenth of a millimetre as radius of gyration
_EXACT_TRIANGLE = 1.0e-6  # relative
_MEASURED = 0.1  # of the largest moment: moments from swinging parts are as wrong as that
_ASYMMETRIC = 1.0e-9  # of the largest entry
_EXPECTED = (
    "expected a pinocchio.Inertia, or mass [kg], mass centre [m] of 3 numbers and inertia about "
    "it [kg·m^2] of 3 x 3"
)


def parse_urdf(
    text: str, source: str, inertias: Mapping[str, Any] | None = None
) -> ElementTree.Element:
    """Root element of a URDF that has passed every check of this module.

    Args:
        source: File or topic it came from, for the messages.
        inertias: Of links, in place of those of the text, see `place_inertias`.

    Raises:
        ModelError: Names source, link or joint, attribute and what is wrong.
    """
    if not text.strip():
        raise ModelError(f"{source}: robot description is empty")
    if len(text) > MAX_CHARACTERS:
        raise ModelError(f"{source}: {len(text)} characters, accepted are {MAX_CHARACTERS}")
    try:
        robot = xml_tree(text)
    except MarkupError as error:
        raise ModelError(f"{source}: {error}") from error
    if robot.tag != "robot":
        raise ModelError(f"{source}: root element is <{robot.tag}>, expected <robot>")
    _check_names(robot, source)
    if inertias:
        place_inertias(robot, inertias, source)
    _check_numbers(robot, source)
    _check_joints(robot, source)
    _check_tree(robot, source)
    return robot


def _check_names(robot: ElementTree.Element, source: str) -> None:
    for tag in ("link", "joint"):
        names = [element.get("name") or "" for element in robot.findall(tag)]
        if len(names) > MAX_LINKS:
            raise ModelError(f"{source}: {len(names)} <{tag}>, accepted are {MAX_LINKS}")
        if "" in names:
            raise ModelError(f"{source}: a <{tag}> has no name")
        odd = [name for name in names if not name.isprintable() or len(name) > MAX_NAME]
        if odd:
            raise ModelError(
                f"{source}: <{tag}> name {odd[0]!r}: accepted are up to {MAX_NAME} characters "
                "that can be printed"
            )
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ModelError(f"{source}: <{tag}> name used twice: {', '.join(repeated)}")
    if robot.find("link") is None:
        raise ModelError(f"{source}: no <link>")


def _check_numbers(robot: ElementTree.Element, source: str) -> None:
    for where, element in _numeric_elements(robot):
        for attribute, count in _NUMERIC_ATTRIBUTES.get(element.tag, {}).items():
            text = element.get(attribute)
            if text is None:
                continue
            words, what = text.split(), f"{source}: {where}: <{element.tag} {attribute}='{text}'>"
            sound = all(_NUMBER.fullmatch(word) and math.isfinite(float(word)) for word in words)
            if len(words) != count or not sound:
                expected = "a finite number" if count == 1 else f"{count} finite numbers"
                raise ModelError(f"{what}: expected {expected} such as 1.5e-3")
            if element.tag != _WITHOUT_RANGE and max(abs(float(w)) for w in words) > LARGEST:
                raise ModelError(f"{what}: accepted are {-LARGEST:g} .. {LARGEST:g}")


def _numeric_elements(robot: ElementTree.Element) -> Iterator[tuple[str, ElementTree.Element]]:
    for owner in (*robot.findall("link"), *robot.findall("joint")):
        where = f"{owner.tag} '{owner.get('name')}'"
        scope = owner.findall("inertial") if owner.tag == "link" else [owner]
        for element in scope:
            for child in element:
                yield where, child


def _check_joints(robot: ElementTree.Element, source: str) -> None:
    moving = sum(joint.get("type") != "fixed" for joint in robot.findall("joint"))
    if moving > MAX_JOINTS:
        raise ModelError(f"{source}: {moving} joints that move, accepted are {MAX_JOINTS}")
    links = {link.get("name") for link in robot.findall("link")}
    for joint in robot.findall("joint"):
        where = f"{source}: joint '{joint.get('name')}'"
        kind = joint.get("type")
        if kind not in JOINT_TYPES:
            raise ModelError(f"{where}: type '{kind}', accepted: {', '.join(JOINT_TYPES)}")
        for role in ("parent", "child"):
            element = joint.find(role)
            link = None if element is None else element.get("link")
            if link not in links:
                raise ModelError(f"{where}: {role} link '{link}' does not exist")
        axis = math.hypot(*numbers(joint.find("axis"), "xyz", "1 0 0"))
        if kind != "fixed" and axis < _SHORTEST_AXIS:
            state = f"shorter than {_SHORTEST_AXIS:g}" if axis else "zero"
            raise ModelError(f"{where}: axis is {state}")
        limit, needed = joint.find("limit"), kind in ("revolute", "prismatic")
        lacks = limit is not None and None in (limit.get("effort"), limit.get("velocity"))
        if (needed and limit is None) or (lacks and kind != "continuous"):
            raise ModelError(f"{where}: a {kind} joint needs <limit> with effort and velocity")


def _check_tree(robot: ElementTree.Element, source: str) -> None:
    parent: dict[str, str] = {}
    for joint in robot.findall("joint"):
        child = link_name(joint, "child")
        if child in parent:
            raise ModelError(f"{source}: link '{child}' is the child of two joints")
        parent[child] = link_name(joint, "parent")
    names = [link.get("name", "") for link in robot.findall("link")]
    roots = [name for name in names if name not in parent]
    if len(roots) != 1:
        found = ", ".join(roots) or "none: the joints form a cycle"
        raise ModelError(f"{source}: expected one root link, found {found}")
    for name in names:
        seen = {name}
        while (name := parent.get(name, "")) in parent:
            if name in seen:
                raise ModelError(f"{source}: links form a cycle through '{name}'")
            seen.add(name)


def check_inertias(
    robot: ElementTree.Element, source: str, any_inertias: bool = False
) -> tuple[str, ...]:
    """Refuse inertias that no body can have, and say which ones are in doubt.

    A negative mass, or a moment that is negative by more than rounding, would give motion a
    negative energy: no result would mean anything. Moments that miss the triangle
    inequality by more than measuring errors belong to no body either. All else is published
    practice that inverse dynamics can use: links without mass, point masses, rods, inertia without
    mass about the only axis that moves it. Whether forward dynamics can use
    it depends on the whole mechanism: see `core/dynamics/mass.py`.

    Args:
        robot: The `<robot>` element; names, numbers and joints are checked.
        source: File or topic it came from, for the messages.
        any_inertias: Whether moments that no body has are in doubt only: published models have
            some, and the mass matrix of the whole is mostly sound all the same.

    Returns:
        What is in doubt, a line a link.

    Raises:
        ModelError: Names source, link, value and condition.
    """
    joints = [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    moving = {link_name(joint, "child") for joint in joints}
    doubts: list[str] = []
    heavy = set()
    for link in robot.findall("link"):
        inertial, name = link.find("inertial"), link.get("name", "")
        if inertial is None:
            continue
        _check_complete(inertial, f"{source}: link '{name}'")
        mass = numbers(inertial.find("mass"), "value", "0")[0]
        tensor = _tensor(inertial)
        if mass > 0 or tensor.any():
            heavy.add(name)
        _refuse(mass, tensor, f"{source}: link '{name}'", any_inertias)
        found = list(_doubts(mass, tensor, name in moving))
        doubts.extend(f"link '{name}': {text}" for text in found)
    return (*doubts, *_without_mass(robot, moving, heavy))


def _check_complete(inertial: ElementTree.Element, where: str) -> None:
    for tag, attributes in (("mass", ("value",)), ("inertia", _MOMENTS)):
        element = inertial.find(tag)
        lacking = [key for key in attributes if element is None or key not in element.attrib]
        if lacking:  # the URDF reader would drop the whole <inertial>
            raise ModelError(f"{where}: <{tag}> lacks {', '.join(lacking)}")


def _tensor(inertial: ElementTree.Element) -> Array:
    element = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (numbers(element, key, "0")[0] for key in _MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _refuse(mass: float, tensor: Array, where: str, any_inertias: bool) -> None:
    if mass < 0:
        raise ModelError(f"{where}: mass is {mass:g} kg, expected > 0")
    if any_inertias:
        return
    first, second, third = np.linalg.eigvalsh(tensor)
    if first < -(_ROUNDED * third + _POINT * mass):
        raise ModelError(
            f"{where}: inertia is not positive definite, smallest principal moment {first:g} "
            "kg m^2, and that is more than rounding"
        )
    if mass > 0 and first + second < third * (1 - _MEASURED) - _POINT * mass:
        raise ModelError(
            f"{where}: inertia violates the triangle inequality: principal moments "
            f"{first:g} + {second:g} < {third:g} kg m^2, by more than measuring errors"
        )


def _doubts(mass: float, tensor: Array, moves: bool) -> Iterator[str]:
    if mass == 0:
        if tensor.any():
            yield "inertia without mass"
        elif moves:
            yield "mass is 0 kg"
        return
    first, second, third = np.linalg.eigvalsh(tensor)
    if not tensor.any():
        yield "a point mass, all moments of inertia are 0"
    elif first <= 0:
        yield f"inertia is not positive definite, smallest principal moment {first:g} kg m^2"
    elif first + second < third * (1 - _EXACT_TRIANGLE):
        yield (
            f"inertia misses the triangle inequality: principal moments {first:g} + {second:g} "
            f"< {third:g} kg m^2"
        )


def _without_mass(robot: ElementTree.Element, moving: set[str], heavy: set[str]) -> Iterator[str]:
    parent = {link_name(j, "child"): link_name(j, "parent") for j in robot.findall("joint")}
    carried = set(heavy)
    for name in heavy:
        while (name := parent.get(name, "")) and name not in carried:
            carried.add(name)
    for name in sorted(moving - carried):
        yield f"link '{name}' moves, but neither it nor what it carries has mass"


def is_impossible(mass: float, tensor: Array) -> bool:
    """Whether `check_inertias` refuses moments, by more than measuring errors."""
    try:
        _refuse(mass, tensor, "", False)
    except ModelError:
        return mass >= 0
    return False


def place_inertias(robot: ElementTree.Element, inertias: Mapping[str, Any], source: str) -> None:
    """Put inertias into a description; its checks come afterwards.

    Args:
        robot: The `<robot>` element, changed in place.
        inertias: Link -> `pinocchio.Inertia` or (mass [kg], mass centre [m], shape (3,), inertia
            about the mass centre [kg·m^2], shape (3, 3)), both in the axes of the link.
        source: File or topic of the description, for the messages.

    Raises:
        ModelError: There is no such link, or the numbers have another shape.
    """
    links = {link.get("name", ""): link for link in robot.findall("link")}
    for name, inertia in inertias.items():
        if name not in links:
            raise ModelError(f"{source}: no link '{name}'; the links are {', '.join(links)}")
        mass, centre, tensor = _numbers(inertia, f"{source}: link '{name}'")
        link = links[name]
        for old in link.findall("inertial"):
            link.remove(old)
        inertial = ElementTree.SubElement(link, "inertial")
        words = " ".join(repr(float(value)) for value in centre)
        ElementTree.SubElement(inertial, "origin", {"xyz": words})
        ElementTree.SubElement(inertial, "mass", {"value": repr(mass)})
        upper = (repr(float(value)) for value in tensor[np.triu_indices(3)])
        moments = dict(zip(_MOMENTS, upper, strict=True))
        ElementTree.SubElement(inertial, "inertia", moments)


def _numbers(inertia: Any, where: str) -> tuple[float, Array, Array]:
    if isinstance(inertia, pin.Inertia):
        inertia = (inertia.mass, inertia.lever, inertia.inertia)
    try:
        mass, centre, tensor = (np.array(value, dtype=np.float64) for value in inertia)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{where}: {_EXPECTED}") from error
    if (mass.shape, centre.shape, tensor.shape) != ((), (3,), (3, 3)):
        raise ModelError(f"{where}: {_EXPECTED}")
    if np.abs(tensor - tensor.T).max() > _ASYMMETRIC * np.abs(tensor).max():
        raise ModelError(f"{where}: inertia is not symmetric")
    return float(mass), centre, tensor


def inertias_of(robot: ElementTree.Element) -> dict[str, Any]:
    """Link -> `pinocchio.Inertia` of a checked description, 0 where it says nothing."""
    inertias = {}
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            inertias[link.get("name", "")] = pin.Inertia.Zero()
            continue
        placement = inertial.find("origin")
        R = pin.rpy.rpyToMatrix(np.array(numbers(placement, "rpy", "0 0 0")))
        centre = np.array(numbers(placement, "xyz", "0 0 0"))
        mass = numbers(inertial.find("mass"), "value", "0")[0]
        inertias[link.get("name", "")] = pin.Inertia(mass, centre, R @ _tensor(inertial) @ R.T)
    return inertias


def numbers(element: ElementTree.Element | None, attribute: str, default: str) -> list[float]:
    """Numbers of one attribute that has been checked before."""
    text = default if element is None else element.get(attribute, default)
    return [float(word) for word in text.split()]


def link_name(joint: ElementTree.Element, role: str) -> str:
    """Name of the `parent` or `child` link of a checked joint."""
    element = joint.find(role)
    assert element is not None
    return element.get("link", "")


def root_link(tree: ElementTree.Element) -> str:
    """Name of the link that no joint carries."""
    carried = {link_name(joint, "child") for joint in tree.findall("joint")}
    names = (link.get("name", "") for link in tree.findall("link"))
    return next(name for name in names if name not in carried)


def joint_kinds(tree: ElementTree.Element) -> dict[str, str]:
    """Joint -> its type."""
    return {e.get("name", ""): e.get("type", "") for e in tree.findall("joint")}


def has_effort_limit(joint: ElementTree.Element) -> bool:
    """Whether the description limits the effort of a joint."""
    limit = joint.find("limit")
    return limit is not None and "effort" in limit.attrib
