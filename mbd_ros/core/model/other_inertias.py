"""Inertias of links in place of those of a description, and what a description says of them."""

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.urdf_reading import numbers
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_AXES = "xyz"
_PAIRS = [(i, j) for i in range(3) for j in range(i, 3)]
_ASYMMETRIC = 1.0e-9  # of the largest entry
_EXPECTED = (
    "expected a pinocchio.Inertia, or mass [kg], mass centre [m] of 3 numbers and inertia about "
    "it [kg·m^2] of 3 x 3"
)


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
        moments = {f"i{_AXES[i]}{_AXES[j]}": repr(float(tensor[i, j])) for i, j in _PAIRS}
        ElementTree.SubElement(inertial, "inertia", moments)


def inertias_of(robot: ElementTree.Element) -> dict[str, Any]:
    """Link -> `pinocchio.Inertia` of a checked description, 0 where it says nothing."""
    found = {}
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            found[link.get("name", "")] = pin.Inertia.Zero()
            continue
        place, given = inertial.find("origin"), inertial.find("inertia")
        turned = pin.rpy.rpyToMatrix(np.array(numbers(place, "rpy", "0 0 0")))
        tensor = np.zeros((3, 3))
        for i, j in _PAIRS:
            tensor[i, j] = tensor[j, i] = numbers(given, f"i{_AXES[i]}{_AXES[j]}", "0")[0]
        mass = numbers(inertial.find("mass"), "value", "0")[0]
        centre = np.array(numbers(place, "xyz", "0 0 0"))
        found[link.get("name", "")] = pin.Inertia(mass, centre, turned @ tensor @ turned.T)
    return found


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
