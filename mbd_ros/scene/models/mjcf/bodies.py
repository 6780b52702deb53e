"""Bodies of a model in the order of the tree, with what they hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import pinocchio as pin

from mbd_ros.scene.models.mjcf.inertia import geom_place
from mbd_ros.scene.models.mjcf.item import Compiler, Defaults, Item, placed
from mbd_ros.scene.models.urdf_text import Names

WORLD = "world"
_PLACING = ("name", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")
_BODY = (*_PLACING, "childclass", "class", "mocap", "gravcomp", "sleep", "user")
_INERTIAL = (*_PLACING, "mass", "diaginertia", "fullinertia")
_HELD = ("joint", "freejoint", "inertial", "geom", "site", "body", "frame", "camera", "light")
_MAKERS = ("composite", "flexcomp", "plugin")
_REFUSED = ("replicate", "attach")
_DEEPEST = 200


class Bodies:
    """All bodies of a model, the world first.

    Args:
        root: `<mujoco>`.
        defaults: Its default classes.
        source: File, for the messages.

    Attributes:
        all: By name, each after its parent.

    Raises:
        SceneError: Names file, element and what is wrong.
    """

    def __init__(self, root: Element, defaults: Defaults, compiler: Compiler, source: str) -> None:
        self._defaults, self._compiler, self._source = defaults, compiler, source
        self.all: dict[str, Body] = {}
        names = [one.get("name", "") for one in root.iterfind("worldbody//body")]
        self._names = Names([WORLD, *names])
        place = pin.SE3.Identity()
        world = Body(Item(root, source), WORLD, "", place, place, [], [], [], [], [])
        self.all[WORLD] = world
        for section in root.iterfind("worldbody"):
            self._fill(world, section, section.get("childclass", ""), place, 0)

    def elements(self, kind: str) -> Iterator[tuple[Body, Placed]]:
        """All geoms, sites or joints with their bodies; `kind` names the list."""
        for body in self.all.values():
            for one in getattr(body, kind):
                yield body, one

    def _fill(self, body: Body, holder: Element, around: str, frame: Any, depth: int) -> None:
        if depth > _DEEPEST:
            raise body.item.error(f"bodies and frames are nested deeper than {_DEEPEST}")
        for element in holder:
            tag = element.tag
            if tag in _REFUSED:
                raise Item(element, self._source).error(
                    f"<{tag}> in body '{body.name}' is not read: write its bodies out"
                )
            if tag in _MAKERS:
                body.others.append(Item(element, self._source))
            elif tag == "body":
                self._add(body, element, around, frame, depth)
            elif tag == "frame":
                at = frame * placed(Item(element, self._source), self._compiler)
                self._fill(body, element, element.get("childclass", around), at, depth + 1)
            elif tag in _HELD:
                self._hold(body, element, around, frame)
            else:
                raise body.item.error(
                    f"unknown element <{tag}>, accepted: {', '.join((*_HELD, *_MAKERS))}"
                )

    def _add(self, parent: Body, element: Element, around: str, frame: Any, depth: int) -> None:
        item = Item(element, self._source).only(_BODY)
        name = item.name or self._names.take(f"body_{len(self.all)}")
        if name in self.all:
            raise item.error(f"there are two bodies '{name}'")
        at = frame * placed(item, self._compiler)
        body = Body(item, name, parent.name, at, parent.world * at, [], [], [], [], [])
        self.all[name] = body
        inner = element.get("childclass", around)
        self._fill(body, element, inner, pin.SE3.Identity(), depth + 1)

    def _hold(self, body: Body, element: Element, around: str, frame: Any) -> None:
        tag = element.tag
        if tag == "inertial":
            item = Item(element, self._source).only(_INERTIAL)
            body.inertial.append(Placed(item, frame))
        elif tag == "freejoint":
            body.joints.append(Placed(Item(element, self._source), frame))
        elif tag in ("joint", "geom", "site"):
            item = self._defaults.item(element, around)
            own = tag != "joint"
            place = frame * geom_place(item, self._compiler) if own else frame
            getattr(body, f"{tag}s").append(Placed(item, place))


class Body(NamedTuple):
    """A body.

    Attributes:
        name: Of its link.
        parent: Name of the body that carries it; empty for the world.
        at: `pinocchio.SE3` in its parent.
        world: In the world, at the reference pose.
        inertial: Element `<inertial>`, if any.
        joints: Its joints; their place is that of the frame around them.
        others: What a scene has no place for.
    """

    item: Item
    name: str
    parent: str
    at: Any
    world: Any
    inertial: list[Placed]
    joints: list[Placed]
    geoms: list[Placed]
    sites: list[Placed]
    others: list[Item]


class Placed(NamedTuple):
    """An element and its place in its body, `pinocchio.SE3`."""

    item: Item
    at: Any
