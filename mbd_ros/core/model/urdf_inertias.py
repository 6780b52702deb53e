"""Whether the masses and inertias of a URDF can exist, and move."""

from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np

from mbd_ros.core.model.urdf_reading import link_name, numbers
from mbd_ros.errors import ModelError

_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_ROUNDED = 1.0e-3  # of the largest moment: published tensors have three digits, turned they mix
_POINT = 1.0e-8  # m^2: a tenth of a millimetre as radius of gyration
_EXACT_TRIANGLE = 1.0e-6  # relative
_MEASURED = 0.1  # of the largest moment: moments from swinging parts are as wrong as that


def check_inertias(
    robot: ElementTree.Element, source: str, any_inertias: bool = False
) -> tuple[str, ...]:
    """Refuse inertias that no body can have, and say which ones are in doubt.

    A negative mass, or a moment that is negative by more than rounding, would give motion a
    negative energy: no result would mean anything. Moments that miss the triangle
    inequality by more than measuring errors belong to no body either. All else is published
    practice that inverse dynamics can use: links without mass, point masses, rods, inertia without
    mass about the only axis that moves it. Whether forward dynamics can use
    it depends on the whole mechanism: see `core/dynamics/mass_check.py`.

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


def _refuse(mass: float, tensor: np.ndarray, where: str, any_inertias: bool) -> None:
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


def is_impossible(mass: float, tensor: np.ndarray) -> bool:
    """Whether `check_inertias` refuses moments, by more than measuring errors."""
    try:
        _refuse(mass, tensor, "", False)
    except ModelError:
        return mass >= 0
    return False


def _doubts(mass: float, tensor: np.ndarray, moves: bool) -> Iterator[str]:
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


def _tensor(inertial: ElementTree.Element) -> np.ndarray:
    element = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (numbers(element, key, "0")[0] for key in _MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _without_mass(robot: ElementTree.Element, moving: set[str], heavy: set[str]) -> Iterator[str]:
    parent = {link_name(j, "child"): link_name(j, "parent") for j in robot.findall("joint")}
    carried = set(heavy)
    for name in heavy:
        while (name := parent.get(name, "")) and name not in carried:
            carried.add(name)
    for name in sorted(moving - carried):
        yield f"link '{name}' moves, but neither it nor what it carries has mass"
