"""An element of an MJCF model: its attributes with those of its default class, checked."""

import math
from collections.abc import Collection, Mapping, Sequence
from xml.etree.ElementTree import Element

from mbd_ros.core.ranges import LARGEST
from mbd_ros.errors import SceneError


class Item:
    """An element that describes something, such as `<joint name="knee">`.

    Args:
        element: The element.
        source: File, for the messages.
        defaults: Attributes that it has where it does not give them.
    """

    def __init__(
        self, element: Element, source: str, defaults: Mapping[str, str] | None = None
    ) -> None:
        self.element, self.source = element, source
        self._given = {**(defaults or {}), **element.attrib}

    @property
    def type(self) -> str:
        """Its tag."""
        return self.element.tag

    @property
    def name(self) -> str:
        """Its name, empty without one."""
        return self.element.get("name", "").strip()

    def error(self, text: str) -> SceneError:
        """What is wrong with this element."""
        title = f"{self.type} '{self.name}'" if self.name else self.type
        return SceneError(f"{self.source}: {title}: {text}")

    def __contains__(self, key: str) -> bool:
        return key in self._given

    def only(self, accepted: Collection[str]) -> "Item":
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
        return self._given.get(key, default).strip()

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
        given = self.numbers(key, least or size, size) if key in self else []
        return [*given, *map(float, default[len(given) :])]

    def _number(self, word: str, key: str) -> float:
        try:
            number = float(word)
        except ValueError as error:
            raise self.error(f"{key} holds '{word}', expected a number") from error
        if not math.isfinite(number) or abs(number) > LARGEST:
            raise self.error(f"{key} holds {word}, accepted are {-LARGEST:g} .. {LARGEST:g}")
        return number
