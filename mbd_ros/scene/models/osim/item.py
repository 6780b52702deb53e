"""An element of a model: its type, its name and its values, checked."""

import math
from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

from mbd_ros.core.ranges import LARGEST
from mbd_ros.errors import SceneError

_TRUE, _FALSE = ("true", "1"), ("false", "0")


class Item:
    """An element that describes something, such as `<Body name="femur_r">`.

    A value that an element leaves out is that of an element of the same type in the `<defaults>`
    of the model, if there is one, and otherwise the default of OpenSim.

    Args:
        element: The element.
        source: File, for the messages.
        defaults: Elements of `<defaults>` by type.
        outer: The element that holds it.
    """

    def __init__(
        self,
        element: Element,
        source: str,
        defaults: "dict[str, Element] | None" = None,
        outer: "Item | None" = None,
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
        """What is wrong with this element."""
        return SceneError(f"{self.where}: {text}")

    def find(self, *tags: str) -> "Item | None":
        """The first element inside with one of these tags."""
        for tag in tags:
            found = self._child(tag)
            if found is not None:
                return Item(found, self.source, self.defaults, self)
        return None

    def text(self, *tags: str, default: str = "") -> str:
        """Text of the first of these elements that has some."""
        for tag in tags:
            found = self._child(tag)
            if found is not None and found.text and found.text.strip():
                return found.text.strip()
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
        found = self.numbers(*tags)
        if not found and default is not None:
            return default
        if len(found) != 1:
            raise self.error(f"<{tags[0]}> has {len(found)} numbers, expected 1")
        return found[0]

    def vector(
        self, *tags: str, default: Sequence[float] | None = (0.0, 0.0, 0.0), length: int = 3
    ) -> list[float]:
        """The numbers of an element, as many as `length`.

        Raises:
            SceneError: It is missing and has no default, or has another number of numbers.
        """
        found = self.numbers(*tags)
        if not found and default is not None:
            return [float(one) for one in default]
        if len(found) != length:
            raise self.error(f"<{tags[0]}> has {len(found)} numbers, expected {length}")
        return found

    def objects(self, *tags: str) -> "Iterator[Item]":
        """The elements of a set: in `<objects>`, or in the set itself."""
        holder = self.find(*tags)
        if holder is None:
            return
        inner = holder.find("objects")
        for element in (holder if inner is None else inner).element:
            if element.tag not in ("groups", "objects"):
                yield Item(element, self.source, self.defaults, self)

    def components(self, *tags: str, ending: str) -> "Iterator[Item]":
        """The elements of a set, and those components of this one whose type ends so."""
        yield from self.objects(*tags)
        for holder in ("components", "ComponentSet"):
            for item in self.objects(holder):
                if item.type.endswith(ending):
                    yield item

    def children(self) -> "Iterator[Item]":
        """All elements inside."""
        for element in self.element:
            yield Item(element, self.source, self.defaults, self)

    def _child(self, tag: str) -> Element | None:
        found = self.element.find(tag)
        if found is None and self.type in self.defaults:
            return self.defaults[self.type].find(tag)
        return found

    def _number(self, word: str, tag: str) -> float:
        try:
            number = float(word)
        except ValueError as error:
            raise self.error(f"<{tag}> holds '{word}', expected a number") from error
        if not math.isfinite(number) or abs(number) > LARGEST:
            raise self.error(f"<{tag}> holds {word}, accepted are {-LARGEST:g} .. {LARGEST:g}")
        return number
