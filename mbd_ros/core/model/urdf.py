"""Parse and check URDF text: numbers, the tree of links, masses and inertias.

`parse_urdf` refuses ambiguous descriptions, `check_inertias` refuses physically impossible masses
and moments of inertia and warns of implausible ones. The other functions read a checked tree.
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
MAX_JOINTS = 300  # moving joints; a Pinocchio Data takes 32 nv^3 bytes, here 0.9 GB
MAX_LINKS = 1000  # Pinocchio's URDF reader overflows the stack on chains of a few thousand
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WITHOUT_RANGE = "limit"  # many files write 1e308 for no limit
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
_ROUNDED = 1.0e-3  # of the largest moment: published tensors have three digits
_POINT = 1.0e-8  # [m^2], a radius of gyration of 0.1 mm
_EXACT_TRIANGLE = 1.0e-6  # relative
_MEASURED = 0.1  # of the largest moment: the error of moments from swing tests
_ASYMMETRIC = 1.0e-9  # of the largest entry
_EXPECTED = (
    "expected a pinocchio.Inertia, or mass [kg], mass centre [m] of 3 numbers and inertia about "
    "it [kg·m^2] of 3 x 3"
)


def parse_urdf(
    text: str, source: str, inertias: Mapping[str, Any] | None = None
) -> ElementTree.Element:
    """Parse a URDF and check names, numbers, joints and the tree of links.

    Args:
        text: URDF text.
        source: File or topic of the text, for messages.
        inertias: Inertias of links that replace those of the text, see `place_inertias`.

    Returns:
        The root element.

    Raises:
        ModelError: A check failed; the message names source, link or joint, and attribute.
    """
    if not text.strip():
        raise ModelError(f"{source}: robot description is empty")
    if len(text) > MAX_CHARACTERS:
        raise ModelError(f"{source}: has {len(text)} characters, accepted are {MAX_CHARACTERS}")
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
            raise ModelError(
                f"{source}: has {len(names)} elements <{tag}>, accepted are {MAX_LINKS}"
            )
        if "" in names:
            raise ModelError(f"{source}: a <{tag}> has no name")
        unusable = [name for name in names if not name.isprintable() or len(name) > MAX_NAME]
        if unusable:
            raise ModelError(
                f"{source}: <{tag}> name {unusable[0]!r}: accepted are up to {MAX_NAME} printable "
                "characters"
            )
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ModelError(f"{source}: <{tag}> name used twice: {', '.join(repeated)}")
    if robot.find("link") is None:
        raise ModelError(f"{source}: has no <link>")


def _check_numbers(robot: ElementTree.Element, source: str) -> None:
    for where, element in _numeric_elements(robot):
        for attribute, count in _NUMERIC_ATTRIBUTES.get(element.tag, {}).items():
            text = element.get(attribute)
            if text is None:
                continue
            values = text.split()
            entry = f"{source}: {where}: <{element.tag} {attribute}='{text}'>"
            are_finite = all(_NUMBER.fullmatch(v) and math.isfinite(float(v)) for v in values)
            if len(values) != count or not are_finite:
                expected = "a finite number" if count == 1 else f"{count} finite numbers"
                raise ModelError(f"{entry}: expected {expected} such as 1.5e-3")
            if element.tag != _WITHOUT_RANGE and max(abs(float(v)) for v in values) > LARGEST:
                raise ModelError(f"{entry}: accepted are {-LARGEST:g} .. {LARGEST:g}")


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
        raise ModelError(f"{source}: has {moving} moving joints, accepted are {MAX_JOINTS}")
    links = {link.get("name") for link in robot.findall("link")}
    for joint in robot.findall("joint"):
        where = f"{source}: joint '{joint.get('name')}'"
        kind = joint.get("type")
        if kind not in JOINT_TYPES:
            raise ModelError(f"{where}: type is '{kind}', accepted: {', '.join(JOINT_TYPES)}")
        for role in ("parent", "child"):
            element = joint.find(role)
            link = None if element is None else element.get("link")
            if link not in links:
                raise ModelError(f"{where}: {role} link '{link}' does not exist")
        axis = math.hypot(*numbers(joint.find("axis"), "xyz", "1 0 0"))
        if kind != "fixed" and axis < _SHORTEST_AXIS:
            state = f"shorter than {_SHORTEST_AXIS:g}" if axis else "zero"
            raise ModelError(f"{where}: axis is {state}")
        limit, is_required = joint.find("limit"), kind in ("revolute", "prismatic")
        is_incomplete = limit is not None and None in (limit.get("effort"), limit.get("velocity"))
        if (is_required and limit is None) or (is_incomplete and kind != "continuous"):
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
        root_names = ", ".join(roots) or "none: the joints form a cycle"
        raise ModelError(f"{source}: expected one root link, found {root_names}")
    for name in names:
        visited = {name}
        while (name := parent.get(name, "")) in parent:
            if name in visited:
                raise ModelError(f"{source}: links form a cycle through '{name}'")
            visited.add(name)


def check_inertias(
    robot: ElementTree.Element, source: str, any_inertias: bool = False
) -> tuple[str, ...]:
    """Refuse physically impossible inertias, and warn of implausible ones.

    A negative mass, or a moment of inertia that is negative by more than rounding, would make the
    kinetic energy negative. Moments that violate the triangle inequality by more than measurement
    errors are impossible, too. Everything else occurs in published models, and inverse dynamics
    can use it: links without mass, point masses, rods, and inertia without mass about the only
    axis of motion. Whether forward dynamics can use it depends on the whole mechanism; see
    `mbd_ros.core.dynamics.mass`.

    Args:
        robot: The `<robot>` element with checked names, numbers and joints.
        source: File or topic of the description, for messages.
        any_inertias: Whether impossible moments only cause a warning. Some published models have
            such moments although their mass matrix is positive definite.

    Returns:
        Warnings, one per link.

    Raises:
        ModelError: An inertia is impossible; the message names source, link, value and condition.
    """
    joints = [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    moving = {link_name(joint, "child") for joint in joints}
    warnings: list[str] = []
    links_with_inertia = set()
    for link in robot.findall("link"):
        inertial, name = link.find("inertial"), link.get("name", "")
        if inertial is None:
            continue
        _check_complete(inertial, f"{source}: link '{name}'")
        mass = numbers(inertial.find("mass"), "value", "0")[0]
        tensor = _tensor(inertial)
        if mass > 0 or tensor.any():
            links_with_inertia.add(name)
        _refuse_impossible(mass, tensor, f"{source}: link '{name}'", any_inertias)
        texts = _implausibilities(mass, tensor, name in moving)
        warnings.extend(f"link '{name}': {text}" for text in texts)
    return (*warnings, *_massless(robot, moving, links_with_inertia))


def _check_complete(inertial: ElementTree.Element, where: str) -> None:
    for tag, attributes in (("mass", ("value",)), ("inertia", _MOMENTS)):
        element = inertial.find(tag)
        missing = [key for key in attributes if element is None or key not in element.attrib]
        if missing:  # Pinocchio's URDF reader would silently ignore the <inertial>
            raise ModelError(f"{where}: <{tag}> lacks {', '.join(missing)}")


def _tensor(inertial: ElementTree.Element) -> Array:
    element = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (numbers(element, key, "0")[0] for key in _MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _refuse_impossible(mass: float, tensor: Array, where: str, any_inertias: bool) -> None:
    if mass < 0:
        raise ModelError(f"{where}: mass is {mass:g} kg, but must not be negative")
    if any_inertias:
        return
    first, second, third = np.linalg.eigvalsh(tensor)
    if first < -(_ROUNDED * third + _POINT * mass):
        raise ModelError(
            f"{where}: inertia is not positive definite: its smallest principal moment is "
            f"{first:g} kg m^2, which is more than rounding"
        )
    if mass > 0 and first + second < third * (1 - _MEASURED) - _POINT * mass:
        raise ModelError(
            f"{where}: inertia violates the triangle inequality: principal moments "
            f"{first:g} + {second:g} < {third:g} kg m^2, by more than measurement errors"
        )


def _implausibilities(mass: float, tensor: Array, moves: bool) -> Iterator[str]:
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


def _massless(
    robot: ElementTree.Element, moving: set[str], links_with_inertia: set[str]
) -> Iterator[str]:
    """Yield a warning for every moving link that neither has nor carries any inertia."""
    parent = {link_name(j, "child"): link_name(j, "parent") for j in robot.findall("joint")}
    loaded = set(links_with_inertia)
    for name in links_with_inertia:
        while (name := parent.get(name, "")) and name not in loaded:
            loaded.add(name)
    for name in sorted(moving - loaded):
        yield f"link '{name}' moves, but neither it nor the links that it carries have mass"


def is_impossible(mass: float, tensor: Array) -> bool:
    """Whether `check_inertias` refuses the moments of inertia of a body."""
    try:
        _refuse_impossible(mass, tensor, "", False)
    except ModelError:
        return mass >= 0
    return False


def place_inertias(robot: ElementTree.Element, inertias: Mapping[str, Any], source: str) -> None:
    """Put inertias into a description, which is checked afterwards.

    Args:
        robot: The `<robot>` element, changed in place.
        inertias: Link -> `pinocchio.Inertia` or (mass [kg], mass centre [m], shape (3,), inertia
            about the mass centre [kg·m^2], shape (3, 3)), both in the axes of the link.
        source: File or topic of the description, for messages.

    Raises:
        ModelError: There is no such link, or an inertia has a wrong shape.
    """
    links = {link.get("name", ""): link for link in robot.findall("link")}
    for name, inertia in inertias.items():
        if name not in links:
            raise ModelError(f"{source}: no link '{name}'; the links are {', '.join(links)}")
        mass, centre, tensor = _checked_inertia(inertia, f"{source}: link '{name}'")
        link = links[name]
        for old in link.findall("inertial"):
            link.remove(old)
        inertial = ElementTree.SubElement(link, "inertial")
        xyz = " ".join(repr(float(value)) for value in centre)
        ElementTree.SubElement(inertial, "origin", {"xyz": xyz})
        ElementTree.SubElement(inertial, "mass", {"value": repr(mass)})
        upper = (repr(float(value)) for value in tensor[np.triu_indices(3)])
        moments = dict(zip(_MOMENTS, upper, strict=True))
        ElementTree.SubElement(inertial, "inertia", moments)


def _checked_inertia(inertia: Any, where: str) -> tuple[float, Array, Array]:
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
    """Return link -> `pinocchio.Inertia` of a checked description, zero for links without one."""
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
    """Return the numbers of an attribute of a checked description."""
    text = default if element is None else element.get(attribute, default)
    return [float(word) for word in text.split()]


def link_name(joint: ElementTree.Element, role: str) -> str:
    """Return the name of the `parent` or `child` link of a checked joint."""
    element = joint.find(role)
    assert element is not None
    return element.get("link", "")


def root_link(tree: ElementTree.Element) -> str:
    """Return the name of the root link, which is the child of no joint."""
    children = {link_name(joint, "child") for joint in tree.findall("joint")}
    names = (link.get("name", "") for link in tree.findall("link"))
    return next(name for name in names if name not in children)


def joint_kinds(tree: ElementTree.Element) -> dict[str, str]:
    """Return joint -> type."""
    return {e.get("name", ""): e.get("type", "") for e in tree.findall("joint")}


def has_effort_limit(joint: ElementTree.Element) -> bool:
    """Whether the description limits the effort of a joint."""
    limit = joint.find("limit")
    return limit is not None and "effort" in limit.attrib
