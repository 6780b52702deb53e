"""Bodies and the frames on them: what sockets, connectors and body names of a model mean."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.osim.item import Item

GROUND = "ground"
_HOLDERS = ("components", "objects", "frames")
_DEEPEST = 32  # frames on frames on ..


class Attached(NamedTuple):
    """A frame on a body.

    Attributes:
        body: Name of the body.
        at: `pinocchio.SE3` of the frame in the axes of the body.
    """

    body: str
    at: Any

    def point(self, xyz: Sequence[float]) -> list[float]:
        """A point of the frame in the axes of the body [m], shape (3,)."""
        found: list[float] = self.at.act(np.array(xyz, dtype=np.float64)).tolist()
        return found

    def direction(self, vector: Sequence[float]) -> list[float]:
        """A direction of the frame in the axes of the body, shape (3,)."""
        found: list[float] = (self.at.rotation @ np.array(vector, dtype=np.float64)).tolist()
        return found


def bodies_of(model: Item) -> list[Item]:
    """The bodies of a model."""
    return [*model.components("BodySet", ending="Body")]


class Frames:
    """The bodies and offset frames of a model.

    Args:
        model: The `<Model>`.

    Attributes:
        bodies: Names of the bodies, ground first.
    """

    def __init__(self, model: Item) -> None:
        names = [body.name for body in bodies_of(model)]
        self.bodies = (GROUND, *(name for name in names if name != GROUND))
        self._offsets: dict[str, Item] = {}
        self._scoped: dict[tuple[str, str], Item] = {}
        self._index(model)

    def attached(self, item: Item, *sockets: str) -> Attached:
        """The frame that an element names.

        Args:
            item: The element.
            sockets: What its sockets, or its elements in older files, may be called.

        Raises:
            SceneError: It names none, or one that is not there.
        """
        name = socket(item, *sockets)
        if not name:
            raise item.error(f"names no {sockets[0]}")
        return self._resolve(item, name, 0)

    def _resolve(self, item: Item, path: str, depth: int) -> Attached:
        *before, last = [word for word in path.split("/") if word] or [""]
        if last == "..":
            last = _above(item, path.count(".."))
        owner = before[-1] if before else ""
        offset = _own(item, last) or self._scoped.get((owner, last))
        if offset is None and last in self.bodies:
            return Attached(last, pin.SE3.Identity())
        offset = offset or self._offsets.get(last)
        if offset is None or depth > _DEEPEST:
            state = "frames form a cycle at" if depth > _DEEPEST else "there is no body or frame"
            raise item.error(f"{state} '{path}'; the bodies are {', '.join(self.bodies)}")
        if offset.type == "StationDefinedFrame":
            return self._through_stations(offset, depth)
        parent = socket(offset, "parent", "parent_frame", "parent_body")
        body, at = self._resolve(offset, parent, depth + 1)
        return Attached(body, at * placement(offset, ("translation",), ("orientation",)))

    def _through_stations(self, item: Item, depth: int) -> Attached:
        """A frame given by three points and an origin."""
        found = []
        for point in ("point_a", "point_b", "point_c", "origin_point"):
            path = socket(item, point)
            station = self._offsets.get(path.split("/")[-1])
            if station is None:
                raise item.error(f"there is no station '{path}'")
            frame = self._resolve(station, socket(station, "parent_frame"), depth + 1)
            found.append((frame.body, np.array(frame.point(station.vector("location")))))
        bodies, points = zip(*found, strict=True)
        if len(set(bodies)) > 1:
            raise item.error(f"its points are on {', '.join(sorted(set(bodies)))}")
        return Attached(bodies[0], pin.SE3(station_axes(item, points), points[3]))

    def _index(self, item: Item) -> None:
        for inner in item.children():
            if inner.type in ("PhysicalOffsetFrame", "StationDefinedFrame", "Station"):
                holder = item.outer if item.type in ("objects", "frames", "components") else item
                self._offsets.setdefault(inner.name, inner)
                self._scoped[(holder.name if holder else "", inner.name)] = inner
            self._index(inner)


def socket(item: Item, *names: str) -> str:
    """Path or name of what an element is connected to, as files of any format write it."""
    for name in names:
        tags = (f"socket_{name}", f"socket_{name}_connectee_name", name)
        text = item.text(*tags)
        if text:
            return text
        for connectors in item.children():
            if connectors.type == "connectors":
                for connector in connectors.children():
                    if connector.name == name:
                        return connector.text("connectee_name")
    return ""


def placement(item: Item, at: Sequence[str], turned: Sequence[str]) -> Any:
    """`pinocchio.SE3` of a place [m] and of body-fixed x, y, z angles [rad]."""
    return pin.SE3(body_fixed(item.vector(*turned)), np.array(item.vector(*at)))


def old_placement(item: Item, at: Sequence[str], turned: Sequence[str]) -> Any:
    """As `placement`, for what files before 4.0 write where they now have offset frames.

    OpenSim keeps six digits of these numbers when it reads such a file.
    """
    translation = np.array([six_digits(one) for one in item.vector(*at)])
    return pin.SE3(body_fixed([six_digits(one) for one in item.vector(*turned)]), translation)


def six_digits(number: float) -> float:
    """The number as OpenSim writes it into a converted file."""
    return float(f"{number:.6g}")


def body_fixed(angles: Sequence[float]) -> Array:
    """Rotation about x, then about the new y, then about the new z, shape (3, 3)."""
    x, y, z = (pin.utils.rotate(axis, float(a)) for axis, a in zip("xyz", angles, strict=True))
    rotation: Array = x @ y @ z
    return rotation


def station_axes(item: Item, points: Sequence[Array]) -> Array:
    """Axes along b - a and across the triangle a, b, c, shape (3, 3).

    Raises:
        SceneError: The points are on a line, or the axes are no two different ones.
    """
    a, b, c = points[:3]
    first, across = b - a, np.cross(b - a, c - a)
    names = item.text("ab_axis", default="+x"), item.text("ab_x_ac_axis", default="+y")
    places = ["xyz".find(name[-1]) for name in names]
    if not across.any() or -1 in places or places[0] == places[1]:
        raise item.error(f"axes {' and '.join(names)} of points on a line, or not two axes")
    axes = np.zeros((3, 3))
    for vector, name, place in zip((first, across), names, places, strict=True):
        sign = -1.0 if name.startswith("-") else 1.0
        axes[:, place] = sign * vector / np.linalg.norm(vector)
    third = 3 - sum(places)
    axes[:, third] = np.cross(axes[:, (third + 1) % 3], axes[:, (third + 2) % 3])
    return axes


def _above(item: Item, levels: int) -> str:
    """Name of the component that holds an element, so many levels up."""
    around = item.outer
    while around is not None:
        levels -= around.type not in _HOLDERS
        if levels == 0:
            return around.name
        around = around.outer
    return ""


def _own(item: Item, name: str) -> Item | None:
    """A frame that the element, or one around it, holds itself."""
    around: Item | None = item
    while around is not None:
        for tag in ("frames", "components"):
            for inner in around.objects(tag):
                if inner.type == "PhysicalOffsetFrame" and inner.name == name:
                    return inner
        around = around.outer
    return None
