"""Whether the masses and inertias of a URDF can exist, and move."""

from xml.etree import ElementTree

import numpy as np

from mbd_ros.core.description.urdf_reading import link_name, numbers
from mbd_ros.errors import ModelError

_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_TRIANGLE_TOLERANCE = 1e-6  # published inertias are rounded


def check_inertias(robot: ElementTree.Element, source: str) -> None:
    """Check every inertia, and that whatever moves carries mass.

    Args:
        robot: The `<robot>` element; names, numbers and joints are checked.
        source: File or topic it came from, for the messages.

    Raises:
        ModelError: Names source, link, value and condition.
    """
    moving = {
        link_name(joint, "child")
        for joint in robot.findall("joint")
        if joint.get("type") != "fixed"
    }
    massive = set()
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        name = link.get("name", "")
        if _check_inertial(inertial, name in moving, f"{source}: link '{name}'"):
            massive.add(name)
    _check_moving_mass(robot, moving, massive, source)


def _check_inertial(inertial: ElementTree.Element, moves: bool, where: str) -> bool:
    """Check one `<inertial>`; whether it has mass."""
    for tag, attributes in (("mass", ("value",)), ("inertia", _MOMENTS)):
        element = inertial.find(tag)
        lacking = [key for key in attributes if element is None or key not in element.attrib]
        if lacking:  # the URDF reader would drop the whole <inertial>
            raise ModelError(f"{where}: <{tag}> lacks {', '.join(lacking)}")
    mass = numbers(inertial.find("mass"), "value", "0")[0]
    tensor = _tensor(inertial)
    if mass < 0 or (mass == 0 and (moves or tensor.any())):
        raise ModelError(
            f"{where}: mass is {mass:g} kg, expected > 0 "
            "(a massless intermediate link carries no <inertial>)"
        )
    if mass == 0:
        return False
    first, second, third = np.linalg.eigvalsh(tensor)
    if first <= 0:
        raise ModelError(
            f"{where}: inertia is not positive definite, "
            f"smallest principal moment {first:g} kg m^2"
        )
    if first + second < third * (1 - _TRIANGLE_TOLERANCE):
        raise ModelError(
            f"{where}: inertia violates the triangle inequality: principal moments "
            f"{first:g} + {second:g} < {third:g} kg m^2"
        )
    return True


def _tensor(inertial: ElementTree.Element) -> np.ndarray:
    element = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (numbers(element, key, "0")[0] for key in _MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _check_moving_mass(
    robot: ElementTree.Element, moving: set[str], massive: set[str], source: str
) -> None:
    parent = {link_name(j, "child"): link_name(j, "parent") for j in robot.findall("joint")}
    carried = set(massive)
    for name in massive:
        while (name := parent.get(name, "")) and name not in carried:
            carried.add(name)
    empty = sorted(moving - carried)
    if empty:
        raise ModelError(
            f"{source}: link '{empty[0]}' moves, but neither it nor what it carries has mass"
        )
