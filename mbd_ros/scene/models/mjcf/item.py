"""Elements of an MJCF model: attributes with those of their default classes, checked, and places.

`compiler_of` reads the settings that say what angles and orientations mean.
"""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError

ACTUATORS = (
    *("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder"),
    *("muscle", "adhesion", "dcmotor", "plugin"),
)
_MAIN = "main"
_KINDS = {**dict.fromkeys(ACTUATORS, "general"), "fixed": "tendon", "spatial": "tendon"}
Attributes = ChainMap[str, ChainMap[str, str]]  # kind of element -> attributes, outer classes last
_AXES = np.eye(3)
_TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
_NO_LENGTH = 1.0e-14


class Item:
    """An element that describes something, such as `<joint name="knee">`.

    Args:
        source: File, for the messages.
        defaults: Attributes that it has where it does not give them.
    """

    def __init__(
        self, element: Element, source: str, defaults: Mapping[str, str] | None = None
    ) -> None:
        self.element, self.source = element, source
        self._defaults = defaults or {}

    @property
    def type(self) -> str:
        """Its tag."""
        return self.element.tag

    @property
    def name(self) -> str:
        """Its name, empty without one."""
        return self.element.get("name", "").strip()

    def error(self, text: str) -> SceneError:
        """Return an error that names this element."""
        title = f"{self.type} '{self.name}'" if self.name else self.type
        return SceneError(f"{self.source}: {title}: {text}")

    def __contains__(self, key: str) -> bool:
        return key in self.element.attrib or key in self._defaults

    def only(self, accepted: Collection[str]) -> Item:
        """This element, whose own attributes are all known.

        Raises:
            SceneError: One is not.
        """
        for key in self.element.attrib:
            if key not in accepted:
                raise self.error(f"unknown attribute '{key}', accepted: {', '.join(accepted)}")
        return self

    def text(self, key: str, default: str = "") -> str:
        """An attribute as it stands."""
        return self.element.get(key, self._defaults.get(key, default)).strip()

    def choice(self, key: str, accepted: Sequence[str]) -> str:
        """A word, by default the first of those that are accepted.

        Raises:
            SceneError: It is another one.
        """
        word = self.text(key, accepted[0])
        if word not in accepted:
            raise self.error(f"{key} is '{word}', accepted: {', '.join(accepted)}")
        return word

    def flag(self, key: str, default: bool) -> bool:
        """Whether an attribute says true.

        Raises:
            SceneError: It says neither true nor false.
        """
        words = ("true", "false") if default else ("false", "true")
        return self.choice(key, words) == "true"

    def is_limited(self, key: str, interval: str, auto: bool) -> bool:
        """Whether an interval acts: `true`, `false`, or `auto` where it is given.

        Raises:
            SceneError: Another word.
        """
        word = self.choice(key, ("auto", "true", "false"))
        return interval in self and auto if word == "auto" else word == "true"

    def numbers(self, key: str, least: int, most: int) -> list[float]:
        """Numbers of an attribute that is there.

        Raises:
            SceneError: Another count, or a word that is no finite number.
        """
        words = self.text(key).split()
        if not least <= len(words) <= most:
            wanted = str(least) if least == most else f"{least} .. {most}"
            raise self.error(f"{key} has {len(words)} numbers, expected {wanted}")
        return [self._number(word, key) for word in words]

    def number(self, key: str, default: float) -> float:
        """A number.

        Raises:
            SceneError: More than one, or no finite number.
        """
        return self.numbers(key, 1, 1)[0] if key in self else default

    def vector(self, key: str, default: Sequence[float], least: int = 0) -> list[float]:
        """As many numbers as the default has; with `least` the last ones may be left out.

        Raises:
            SceneError: Another count, or a word that is no finite number.
        """
        size = len(default)
        leading = self.numbers(key, least or size, size) if key in self else []
        return [*leading, *map(float, default[len(leading) :])]

    def _number(self, word: str, key: str) -> float:
        try:
            number = float(word)
        except ValueError as error:
            raise self.error(f"{key} holds '{word}', expected a number") from error
        if not math.isfinite(number) or abs(number) > LARGEST:
            raise self.error(f"{key} holds {word}, accepted are {-LARGEST:g} .. {LARGEST:g}")
        return number


class Defaults:
    """The default classes.

    Args:
        root: `<mujoco>`.
        source: File, for the messages.

    Raises:
        SceneError: A class without a name, or two of one name.
    """

    def __init__(self, root: Element, source: str) -> None:
        self._source = source
        self._classes: dict[str, Attributes] = {_MAIN: ChainMap()}
        self._main = _MAIN
        for element in root.iterfind("default"):
            name = element.get("class", self._main)
            self._classes[name] = self._classes[self._main]
            self._main = name
            self._read(element, name, self._classes[name])

    def item(self, element: Element, around: str = "", kind: str = "") -> Item:
        """An element with the attributes of its class.

        Args:
            around: `childclass` of the bodies and frames around it, if any.
            kind: Its section where its tag does not say it, as in `<equality>`.

        Raises:
            SceneError: There is no such class.
        """
        name = element.get("class") or around or self._main
        if name not in self._classes:
            known = ", ".join(self._classes)
            raise Item(element, self._source).error(
                f"no default class '{name}', there are {known}"
            )
        kind = kind or _KINDS.get(element.tag, element.tag)
        return Item(element, self._source, self._classes[name].get(kind, {}))

    def _read(self, element: Element, name: str, outer: Attributes) -> None:
        defaults = outer.new_child()
        for kind, settings in _settings(element):
            defaults[kind] = (
                defaults[kind].new_child(settings) if kind in defaults else ChainMap(settings)
            )
        self._classes[name] = defaults
        for inner in element.iterfind("default"):
            title = inner.get("class", "")
            if not title:
                raise Item(inner, self._source).error("a default inside another has no class")
            if title in self._classes:
                raise Item(inner, self._source).error(f"class '{title}' is given twice")
            self._read(inner, title, defaults)


def _settings(element: Element) -> Iterator[tuple[str, dict[str, str]]]:
    for child in element:
        if child.tag != "default":
            yield _KINDS.get(child.tag, child.tag), child.attrib


def compiler_of(root: Element, source: str) -> Compiler:
    """The settings; later elements replace earlier ones.

    Raises:
        SceneError: Names attribute and what is accepted.
    """
    settings: dict[str, str] = {}
    for one in root.iterfind("compiler"):
        settings.update(one.attrib)
    item = Item(Element("compiler", settings), source)
    if item.choice("coordinate", ("local", "global")) == "global":
        raise item.error("coordinate is 'global', accepted: local")
    sequence = item.text("eulerseq", "xyz")
    if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
        raise item.error(f"eulerseq is '{sequence}', accepted: three of x, y, z, X, Y, Z")
    groups = item.vector("inertiagrouprange", (0.0, 5.0))
    return Compiler(
        1.0 if item.choice("angle", ("degree", "radian")) == "radian" else np.pi / 180.0,
        sequence,
        item.flag("autolimits", default=True),
        item.choice("inertiafromgeom", ("auto", "true", "false")),
        (groups[0], groups[1]),
        item.number("boundmass", 0.0),
        item.number("boundinertia", 0.0),
        item.flag("balanceinertia", default=False),
        item.number("settotalmass", -1.0),
    )


class Compiler(NamedTuple):
    """Element `<compiler>`.

    Attributes:
        degree: Radians of a unit of angles.
        sequence: Axes of `euler`: small letters turn about the moved axes, capitals about fixed.
        autolimits: Whether what has a range is limited.
        from_geoms: `auto`, `true` or `false`: whether inertia comes from geoms.
        groups: First and last group of geoms that have inertia.
        least_mass: Of a body [kg].
        least_inertia: Of a body, in its principal axes [kg·m^2].
        balances: Whether moments of inertia that no body has become equal.
        total: Mass of the model [kg], negative where it is the sum.
    """

    degree: float
    sequence: str
    autolimits: bool
    from_geoms: str
    groups: tuple[float, float]
    least_mass: float
    least_inertia: float
    balances: bool
    total: float


def placed(item: Item, compiler: Compiler) -> Any:
    """`pinocchio.SE3` of an element in what holds it.

    Raises:
        SceneError: Two orientations, or one of no length.
    """
    at = np.array(item.vector("pos", (0.0, 0.0, 0.0)))
    return pin.SE3(_rotation(item, compiler), at)


def _rotation(item: Item, compiler: Compiler) -> Array:
    keys = [key for key in _TURNS if key in item]
    if len(keys) > 1:
        keys_here = [key for key in keys if key in item.element.attrib]
        if len(keys_here) != 1:
            raise item.error(f"orientation is given twice: {', '.join(keys)}")
        keys = keys_here
    key = keys[0] if keys else ""
    rotation: Array = np.eye(3)
    if key == "quat":
        w, *xyz = unit(item, np.array(item.vector(key, [0.0] * 4)), key)
        rotation = pin.Quaternion(w, *xyz).toRotationMatrix()
    elif key == "axisangle":
        *axis, angle = item.vector(key, [0.0] * 4)
        axis = unit(item, np.array(axis), key)
        rotation = pin.AngleAxis(angle * compiler.degree, axis).toRotationMatrix()
    elif key == "xyaxes":
        x, y = np.reshape(item.vector(key, [0.0] * 6), (2, 3))
        x = unit(item, x, key)
        y = unit(item, y - x * (x @ y), key)
        rotation = np.column_stack((x, y, np.cross(x, y)))
    elif key == "zaxis":
        rotation = turned_to(unit(item, np.array(item.vector(key, [0.0] * 3)), key))
    elif key == "euler":
        for angle, letter in zip(item.vector(key, [0.0] * 3), compiler.sequence, strict=True):
            axis = _AXES["xyz".index(letter.lower())]
            turn = pin.AngleAxis(angle * compiler.degree, axis).toRotationMatrix()
            rotation = rotation @ turn if letter.islower() else turn @ rotation
    return rotation


def unit(item: Item, vector: Array, key: str) -> Array:
    """A vector at length 1.

    Raises:
        SceneError: It has no length.
    """
    length = float(np.linalg.norm(vector))
    if length < _NO_LENGTH:
        raise item.error(f"{key} has no length")
    direction: Array = vector / length
    return direction


def turned_to(direction: Array) -> Array:
    """The smallest rotation that takes z to a direction of length 1, shape (3, 3)."""
    axis = np.cross(_AXES[2], direction)
    sine = float(np.linalg.norm(axis))
    axis = _AXES[0] if sine < 1.0e-10 else axis / sine
    turn: Array = pin.AngleAxis(float(np.arctan2(sine, direction[2])), axis).toRotationMatrix()
    return turn
