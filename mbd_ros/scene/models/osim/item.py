"""Elements of a model, with checked values, and the frames that they name on its bodies.

Sockets, connectors and names of bodies say, in files of all versions, to which frame something is
attached.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.urdf import MAX_LINKS
from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.models.urdf_text import roll_pitch_yaw

GROUND = "ground"
_HOLDERS = ("components", "objects", "frames")
_DEEPEST = 32  # frames on frames on ..
_TRUE, _FALSE = ("true", "1"), ("false", "0")


class Item:
    """An element that describes something, such as `<Body name="femur_r">`.

    A value that an element leaves out is that of an element of the same type in the `<defaults>`
    of the model, if there is one, and otherwise the default of OpenSim.

    Args:
        source: File, for the messages.
        defaults: Elements of `<defaults>` by type.
        outer: The element that holds it.
    """

    def __init__(
        self,
        element: Element,
        source: str,
        defaults: dict[str, Element] | None = None,
        outer: Item | None = None,
    ) -> None:
        self.element, self.source, self.defaults = element, source, defaults or {}
        self.outer = outer

    @property
    def type(self) -> str:
        """Its class in OpenSim."""
        return self.element.tag

    @property
    def name(self) -> str:
        """Its name, empty without one."""
        return self.element.get("name", "").strip()

    @property
    def title(self) -> str:
        """For people: type and name."""
        return f"{self.type} '{self.name}'" if self.name else self.type

    @property
    def where(self) -> str:
        """File and element, for the messages."""
        return f"{self.source}: {self.title}"

    def error(self, text: str) -> SceneError:
        """Return an error that names this element."""
        return SceneError(f"{self.where}: {text}")

    def find(self, *tags: str) -> Item | None:
        """The first element inside with one of these tags."""
        for tag in tags:
            element = self._child(tag)
            if element is not None:
                return Item(element, self.source, self.defaults, self)
        return None

    def text(self, *tags: str, default: str = "") -> str:
        """Text of the first of these elements that has some."""
        for tag in tags:
            element = self._child(tag)
            if element is not None and element.text and element.text.strip():
                return element.text.strip()
        return default

    def words(self, *tags: str) -> list[str]:
        """The words of an element."""
        return self.text(*tags).replace(",", " ").split()

    def flag(self, *tags: str, default: bool = False) -> bool:
        """Whether an element says true.

        Raises:
            SceneError: It says neither true nor false.
        """
        text = self.text(*tags).lower()
        if text and text not in _TRUE + _FALSE:
            raise self.error(f"<{tags[0]}> is '{text}', expected true or false")
        return text in _TRUE if text else default

    def numbers(self, *tags: str) -> list[float]:
        """Numbers of an element, none where it is left out.

        Raises:
            SceneError: A word is no finite number.
        """
        return [self._number(word, tags[0]) for word in self.text(*tags).strip("()~[]").split()]

    def number(self, *tags: str, default: float | None = None) -> float:
        """The number of an element.

        Raises:
            SceneError: It is missing and has no default, or is no finite number.
        """
        values = self.numbers(*tags)
        if not values and default is not None:
            return default
        if len(values) != 1:
            raise self.error(f"<{tags[0]}> has {len(values)} numbers, expected 1")
        return values[0]

    def vector(
        self, *tags: str, default: Sequence[float] | None = (0.0, 0.0, 0.0), length: int = 3
    ) -> list[float]:
        """The numbers of an element, as many as `length`.

        Raises:
            SceneError: It is missing and has no default, or has another number of numbers.
        """
        values = self.numbers(*tags)
        if not values and default is not None:
            return [float(one) for one in default]
        if len(values) != length:
            raise self.error(f"<{tags[0]}> has {len(values)} numbers, expected {length}")
        return values

    def objects(self, *tags: str) -> Iterator[Item]:
        """The elements of a set: in `<objects>`, or in the set itself."""
        holder = self.find(*tags)
        if holder is None:
            return
        inner = holder.find("objects")
        for element in (holder if inner is None else inner).element:
            if element.tag not in ("groups", "objects"):
                yield Item(element, self.source, self.defaults, self)

    def components(self, *tags: str, ending: str | tuple[str, ...]) -> Iterator[Item]:
        """The elements of a set, and those components of this one whose type ends so."""
        yield from self.objects(*tags)
        for holder in ("components", "ComponentSet"):
            for item in self.objects(holder):
                if item.type.endswith(ending):
                    yield item

    def children(self) -> Iterator[Item]:
        """All elements inside."""
        for element in self.element:
            yield Item(element, self.source, self.defaults, self)

    def _child(self, tag: str) -> Element | None:
        child = self.element.find(tag)
        if child is None and self.type in self.defaults:
            return self.defaults[self.type].find(tag)
        return child

    def _number(self, word: str, tag: str) -> float:
        try:
            number = float(word)
        except ValueError as error:
            raise self.error(f"<{tag}> holds '{word}', expected a number") from error
        if not math.isfinite(number) or abs(number) > LARGEST:
            raise self.error(f"<{tag}> holds {word}, accepted are {-LARGEST:g} .. {LARGEST:g}")
        return number


class Frames:
    """The bodies and offset frames of a model.

    Args:
        model: The `<Model>`.

    Attributes:
        bodies: Names of the bodies, ground first.
    """

    def __init__(self, model: Item) -> None:
        names = [body.name for body in bodies_of(model)]
        if len(names) > MAX_LINKS:
            raise model.error(f"{len(names)} bodies, accepted are {MAX_LINKS}")
        self.bodies = (GROUND, *(name for name in names if name != GROUND))
        self._offsets: dict[str, Item] = {}
        self._scoped: dict[tuple[str, str], Item] = {}
        self._frames: dict[Element, dict[str, Item]] = {}
        self._index(model)

    def attached(self, item: Item, *sockets: str) -> Attached:
        """The frame that an element names.

        Args:
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
        offset = self._frame_of(item, last) or self._scoped.get((owner, last))
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

    def _frame_of(self, item: Item, name: str) -> Item | None:
        """A frame that the element, or one around it, holds itself."""
        around: Item | None = item
        while around is not None:
            if around.element not in self._frames:
                self._frames[around.element] = _frames_in(around)
            if name in self._frames[around.element]:
                return self._frames[around.element][name]
            around = around.outer
        return None

    def _through_stations(self, item: Item, depth: int) -> Attached:
        """A frame given by three points and an origin."""
        stations = []
        for point in ("point_a", "point_b", "point_c", "origin_point"):
            path = socket(item, point)
            station = self._offsets.get(path.split("/")[-1])
            if station is None:
                raise item.error(f"there is no station '{path}'")
            frame = self._resolve(station, socket(station, "parent_frame"), depth + 1)
            stations.append((frame.body, np.array(frame.point(station.vector("location")))))
        bodies, points = zip(*stations, strict=True)
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


def _frames_in(item: Item) -> dict[str, Item]:
    """Offset frames that an element holds itself, by name."""
    inside = [inner for tag in ("components", "frames") for inner in item.objects(tag)]
    frames = [inner for inner in inside if inner.type == "PhysicalOffsetFrame"]
    return {inner.name: inner for inner in reversed(frames)}  # the first of a name counts


def bodies_of(model: Item) -> list[Item]:
    """The bodies of a model."""
    return [*model.components("BodySet", ending="Body")]


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
        values: list[float] = self.at.act(np.array(xyz, dtype=np.float64)).tolist()
        return values

    def direction(self, vector: Sequence[float]) -> list[float]:
        """A direction of the frame in the axes of the body, shape (3,)."""
        values: list[float] = (self.at.rotation @ np.array(vector, dtype=np.float64)).tolist()
        return values


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


def _above(item: Item, levels: int) -> str:
    """Name of the component that holds an element, so many levels up."""
    around = item.outer
    while around is not None:
        levels -= around.type not in _HOLDERS
        if levels == 0:
            return around.name
        around = around.outer
    return ""


def placement(item: Item, at: Sequence[str], turned: Sequence[str]) -> Any:
    """`pinocchio.SE3` of a place [m] and of body-fixed x, y, z angles [rad]."""
    return pin.SE3(body_fixed(item.vector(*turned)), np.array(item.vector(*at)))


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


def frame_entries(letter: str, end: Attached) -> dict[str, Any]:
    """Return `frame_a`, `point_a` and `rpy_a` of a part that holds two frames a and b."""
    return {
        f"frame_{letter}": end.body,
        f"point_{letter}": end.at.translation.tolist(),
        f"rpy_{letter}": roll_pitch_yaw(end.at.rotation),
    }


def old_placement(item: Item, at: Sequence[str], turned: Sequence[str]) -> Any:
    """Return a placement as files before version 4.0 write it, without offset frames.

    OpenSim keeps six digits of these numbers when it reads such a file.
    """
    translation = np.array([six_digits(one) for one in item.vector(*at)])
    return pin.SE3(body_fixed([six_digits(one) for one in item.vector(*turned)]), translation)


def six_digits(number: float) -> float:
    """The number as OpenSim writes it into a converted file."""
    return float(f"{number:.6g}")
