"""A scene and a description whose segments have other sizes and masses."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError

_AXES = "xyz"
_UNSCALED = ("constraints", "contacts", "forces", "actuators", "external_wrenches")
Entries = dict[str, Any]
Element = ElementTree.Element
_MOMENTS = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}


def scaled_sections(
    entries: Mapping[str, Any], factors: Mapping[str, Array], stretch: Mapping[str, float]
) -> Entries:
    """Sections with other places; those of muscles are scaled by the lengths of their paths.

    Args:
        entries: By key.
        factors: Link -> factors along its axes, shape (3,).
        stretch: Sliding joint -> factor of its position.

    Raises:
        DataError: A coupling that follows a joint which is stretched itself.
    """
    scaled = deepcopy(dict(entries))
    for entry in scaled.get("sensors", {}).values():
        _scale_place(entry, "xyz", factors.get(entry.get("frame")))
    for path in scaled.get("paths", {}).values():
        for point in path.get("points", []):
            factor = factors.get(point.get("frame"))
            _scale_place(point, "xyz", factor)
            _scale_moves(point.get("moves"), factor)
        for wrap in path.get("wraps", []):
            _scale_wrap(wrap, factors.get(wrap.get("frame")))
    for joint, entry in scaled.get("couplings", {}).items():
        if stretch.get(entry["parent"], 1.0) != 1.0:
            raise DataError(
                f"scale: coupling {joint} follows {entry['parent']}, a sliding joint of a scaled "
                "segment, which is not served"
            )
        _scale_function(entry, stretch.get(joint, 1.0))
    return scaled


def left_as_they_are(entries: Mapping[str, Any]) -> list[str]:
    """Keys of sections with places or sizes that are not scaled."""
    return [key for key in _UNSCALED if entries.get(key)]


def _scale_place(entry: Entries, key: str, factor: Array | None) -> None:
    if factor is not None and key in entry:
        entry[key] = (factor * np.array(entry[key], dtype=np.float64)).tolist()


def _scale_moves(moves: Entries | None, factor: Array | None) -> None:
    if moves is None or factor is None:
        return
    for i, axis in enumerate(_AXES):
        if isinstance(moves.get(axis), dict):
            _scale_function(moves[axis], float(factor[i]))


def _scale_wrap(wrap: Entries, factor: Array | None) -> None:
    """Place by axes; radii and lengths by the mean of the factors."""
    if factor is None:
        return
    if isinstance(wrap.get("pose"), dict):
        _scale_place(wrap["pose"], "xyz", factor)
    mean = float(factor.mean())
    for key in ("cylinder", "sphere", "ellipsoid", "torus"):
        if key in wrap:
            wrap[key] = _times(wrap[key], mean)


def _scale_function(entry: Entries, factor: float) -> None:
    """Values of a coupling function, wherever its kind keeps them."""
    if factor == 1.0:
        return
    for key in ("factor", "offset", "polynomial"):
        if key in entry:
            entry[key] = _times(entry[key], factor)
    if not {"factor", "polynomial"} & entry.keys() and "offset" in entry:
        entry["factor"] = factor
    for key in ("spline", "simm_spline", "linear"):
        if isinstance(entry.get(key), dict):
            entry[key]["y"] = _times(entry[key]["y"], factor)
    if "piecewise_polynomial" in entry:
        pieces = entry["piecewise_polynomial"]
        pieces["coefficients"] = _times(pieces["coefficients"], factor)


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, dict):
        return {key: _times(one, factor) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_times(one, factor) for one in value]
    return factor * value


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
            factor: Of the segment that it belongs to.
            turn: From its axes to those of that segment, shape (3, 3).
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
