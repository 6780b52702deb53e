"""A robot description whose segments have other sizes and masses.

A segment is a link with factors, and links without mass between it and the next one: places in
them are stretched along the axes of the segment. With S = diag(factors), a mass m of density
moments P = tr(I) / 2 - I becomes m' with P' = m'/m S P S, and I' = tr(P') - P'.
"""

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError

Element = ElementTree.Element
_MOMENTS = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}


class ScaledUrdf:
    """A scaled description.

    Args:
        text: URDF.
        factors: Link -> factors along its axes, shape (3,).
        mass: Of all links [kg]; None keeps it.
        by_volume: Whether masses follow volumes; else each keeps its share.

    Attributes:
        text: URDF, scaled.
        stretch: Sliding joint -> factor of its position.
        mass: Of all links before [kg].
    """

    def __init__(
        self, text: str, factors: Mapping[str, Array], mass: float | None, by_volume: bool
    ) -> None:
        tree = ElementTree.fromstring(text)
        self._factors, self.stretch = dict(factors), dict[str, float]()
        self._links = {link.get("name", ""): link for link in tree.findall("link")}
        above = {_child(joint): joint for joint in tree.findall("joint")}
        for name in self._links:
            if name not in above:
                self._place(name, self._factors.get(name, np.ones(3)), np.eye(3), tree)
        self.mass = self._scale_masses(mass, by_volume)
        self.text = ElementTree.tostring(tree, encoding="unicode")

    def _place(self, link: str, factor: Array, turn: Array, tree: Element) -> None:
        """Scale the joints that hang on a link.

        Args:
            link: Its name.
            factor: Of the segment that it belongs to.
            turn: From its axes to those of that segment, shape (3, 3).
            tree: The description.
        """
        for joint in tree.findall("joint"):
            if _parent(joint) != link:
                continue
            child, origin = _child(joint), _origin(joint)
            R = rotation_matrix(_numbers(origin, "rpy"))
            xyz = np.array(_numbers(origin, "xyz"))
            begins = self._is_segment(child)
            own = self._factors.get(child, np.ones(3)) if begins else factor
            if begins and not self._is_segment(link):  # the place of the joint in the child
                xyz = R @ (own * (R.T @ xyz))
            else:
                xyz = turn.T @ (factor * (turn @ xyz))
            origin.set("xyz", " ".join(map(repr, xyz.tolist())))
            if joint.get("type") == "prismatic":
                axis = joint.find("axis")
                along = turn @ R @ np.array(_numbers(axis, "xyz", (1.0, 0.0, 0.0)))
                along /= np.linalg.norm(along)
                self.stretch[joint.get("name", "")] = float(np.linalg.norm(factor * along))
            self._place(child, own, np.eye(3) if begins else turn @ R, tree)

    def _is_segment(self, link: str) -> bool:
        return link in self._factors or self._links[link].find("inertial") is not None

    def _scale_masses(self, mass: float | None, by_volume: bool) -> float:
        found = {
            n: e for n, link in self._links.items() if (e := link.find("inertial")) is not None
        }
        before = {name: _value(e, "mass", "value") for name, e in found.items()}
        factors = {name: self._factors.get(name, np.ones(3)) for name in found}
        volumes = {n: float(factors[n].prod()) if by_volume else 1.0 for n in found}
        total = sum(before.values())
        new = sum(before[name] * volumes[name] for name in found)
        share = (total if mass is None else mass) / new if new else 1.0
        for name, element in found.items():
            after = before[name] * volumes[name] * share
            _scale_inertia(element, factors[name], before[name], after)
        return total


def _scale_inertia(element: Element, factor: Array, before: float, after: float) -> None:
    origin = _origin(element)
    centre = factor * np.array(_numbers(origin, "xyz"))
    origin.set("xyz", " ".join(map(repr, centre.tolist())))
    mass, moments = element.find("mass"), element.find("inertia")
    if mass is None or moments is None:
        raise DataError("an <inertial> lacks <mass> or <inertia>")
    mass.set("value", repr(after))
    tensor = np.zeros((3, 3))
    for key, (i, j) in _MOMENTS.items():
        tensor[i, j] = tensor[j, i] = float(moments.get(key, "0"))
    R = rotation_matrix(_numbers(origin, "rpy"))
    stretch = R.T @ np.diag(factor) @ R
    spread = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    spread = (after / before if before else 1.0) * stretch @ spread @ stretch.T
    tensor = np.trace(spread) * np.eye(3) - spread
    for key, (i, j) in _MOMENTS.items():
        moments.set(key, repr(float(tensor[i, j])))


def _origin(element: Element) -> Element:
    found = element.find("origin")
    return ElementTree.SubElement(element, "origin") if found is None else found


def _numbers(
    element: Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> list[float]:
    text = "" if element is None else element.get(key, "")
    return [float(word) for word in text.split()] or list(default)


def _value(element: Element, tag: str, key: str) -> float:
    found = element.find(tag)
    return 0.0 if found is None else float(found.get(key, "0"))


def _parent(joint: Element) -> str:
    found = joint.find("parent")
    return "" if found is None else found.get("link", "")


def _child(joint: Element) -> str:
    found = joint.find("child")
    return "" if found is None else found.get("link", "")
