"""The state of reading a MuJoCo model: its tree, names and what was left out."""

from collections.abc import Iterator
from functools import cached_property
from typing import Any
from xml.etree.ElementTree import Element

from mbd_ros.scene.models.imported_model import LeftOut, Unexpressed
from mbd_ros.scene.models.mjcf.bodies import WORLD, Placed
from mbd_ros.scene.models.mjcf.item import Compiler, Defaults, Item
from mbd_ros.scene.models.mjcf.mechanism import Hinge, Tree
from mbd_ros.scene.models.urdf_text import Names, xyz_rpy


class Reading:
    """A model that is being read.

    Args:
        root: `<mujoco>`.
        source: File, for the messages.
        defaults: Its default classes.
        tree: Its links and joints.

    Attributes:
        fixed: Joints that do not move -> position [rad or m].
        left_out: Elements that the scene does not have.
        names: Of joints and parts.
        paths: Tendons of the scene -> entry in `paths`.
    """

    def __init__(
        self, root: Element, source: str, defaults: Defaults, compiler: Compiler, tree: Tree
    ) -> None:
        self._root, self._source, self._defaults = root, source, defaults
        self.compiler, self.tree = compiler, tree
        self.fixed: dict[str, float] = {}
        self.left_out: list[LeftOut] = []
        self.names = Names(tree.hinges)
        self.paths: dict[str, dict[str, Any]] = {}
        self.titles: dict[str, str] = {}
        kinds = ("geoms", "sites")
        self._places = {
            kind: {one.item.name: (b.name, one) for b, one in tree.bodies.elements(kind)}
            for kind in kinds
        }

    def items(self, section: str) -> Iterator[Item]:
        """The elements of all sections of a name, with their defaults."""
        kind = section if section == "equality" else ""
        for holder in self._root.iterfind(section):
            for element in holder:
                yield self._defaults.item(element, kind=kind)

    @cached_property
    def tendons(self) -> set[str]:
        """Names of the tendons of the file."""
        return {item.name for item in self.items("tendon")}

    def option(self) -> Item:
        """Element `<option>`; later ones replace earlier ones."""
        settings: dict[str, str] = {}
        for one in self._root.iterfind("option"):
            settings.update(one.attrib)
        return Item(Element("option", settings), self._source)

    def is_weightless(self) -> bool:
        """Whether a flag switches gravity off."""
        flags = [one.get("gravity") for one in self._root.iterfind("option/flag")]
        return "disable" in flags

    def inner(self, item: Item) -> list[Item]:
        """The elements inside one."""
        return [Item(element, self._source) for element in item.element]

    def leave_out(self, item: Item, reason: str) -> None:
        """Note that the scene does not have an element."""
        self.left_out.append(LeftOut(item.type, item.name, reason))

    def joint(self, item: Item, key: str) -> Hinge:
        """The hinge or slide that an element names.

        Raises:
            SceneError: It names none, or one that is not there.
            Unexpressed: A ball, a free joint, or one that does not move.
        """
        name, names = item.text(key), self.tree.joint_names
        if name not in names or not name:
            known = ", ".join(one for one in names if one) or "none"
            raise item.error(f"{key}: there is no joint '{name}'; there are {known}")
        if names[name] != [name]:
            raise Unexpressed(f"'{name}' is no hinge and no slide")
        if name in self.fixed:
            raise Unexpressed(f"'{name}' is locked")
        return self.tree.hinges[name]

    def body(self, item: Item, key: str) -> str:
        """The body that an element names, the world where it names none.

        Raises:
            SceneError: One that is not there.
        """
        name = item.text(key, WORLD)
        if name not in self.tree.bodies.all:
            raise item.error(f"{key}: there is no body '{name}'")
        return name

    def place(self, item: Item, key: str, kind: str = "sites") -> tuple[str, Placed]:
        """The body of a site or geom that an element names, and the place in it.

        Raises:
            SceneError: One that is not there.
        """
        name = item.text(key)
        if name not in self._places[kind] or not name:
            raise item.error(f"{key}: there is no {kind[:-1]} '{name}'")
        return self._places[kind][name]

    def refuse_rigid(self, *bodies: str) -> None:
        """Refuse bodies that no joint moves against each other.

        Raises:
            Unexpressed: Always then.
        """
        if len({self._carrier(body) for body in bodies}) == 1:
            raise Unexpressed("its bodies have no relative motion")

    def _carrier(self, body: str) -> str:
        """The body whose joints, of those that are not locked, carry a body."""
        bodies, name = self.tree.bodies.all, self.tree.carrier(body)
        while name != WORLD and name != self.tree.base and self._is_still(name):
            name = self.tree.carrier(bodies[name].parent)
        return name

    def _is_still(self, body: str) -> bool:
        items = [one.item for one in self.tree.bodies.all[body].joints]
        hinges = [h.name for h in self.tree.hinges.values() if any(h.item is i for i in items)]
        return all(name in self.fixed for name in hinges)

    def placed(self, key: str, body: str, at: Any) -> dict[str, Any]:
        """Entries `frame_<key>`, `point_<key>` and `rpy_<key>`."""
        link, at = self.tree.frame(body, at)
        found = {{"xyz": "point", "rpy": "rpy"}[k]: v for k, v in xyz_rpy(at).items()}
        return {f"frame_{key}": link, **{f"{k}_{key}": v for k, v in found.items()}}
