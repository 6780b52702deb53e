"""Default classes of a model: attributes that elements have by their class."""

from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

from mbd_ros.scene.models.mjcf.item import Item

ACTUATORS = (
    *("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder"),
    *("muscle", "adhesion", "dcmotor", "plugin"),
)
_MAIN = "main"
_KINDS = {**dict.fromkeys(ACTUATORS, "general"), "fixed": "tendon", "spatial": "tendon"}
Attributes = Mapping[str, Mapping[str, str]]


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
        self._classes: dict[str, Attributes] = {_MAIN: {}}
        self._main = _MAIN
        for element in root.iterfind("default"):
            name = element.get("class", self._main)
            self._classes[name] = self._classes[self._main]
            self._main = name
            self._read(element, name, self._classes[name])

    def item(self, element: Element, around: str = "", kind: str = "") -> Item:
        """An element with the attributes of its class.

        Args:
            element: The element.
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
        own = {kind: dict(given) for kind, given in outer.items()}
        for kind, given in _settings(element):
            own[kind] = {**own.get(kind, {}), **given}
        self._classes[name] = own
        for inner in element.iterfind("default"):
            title = inner.get("class", "")
            if not title:
                raise Item(inner, self._source).error("a default inside another has no class")
            if title in self._classes:
                raise Item(inner, self._source).error(f"class '{title}' is given twice")
            self._read(inner, title, own)


def _settings(element: Element) -> Iterator[tuple[str, Mapping[str, str]]]:
    for child in element:
        if child.tag != "default":
            yield _KINDS.get(child.tag, child.tag), child.attrib
