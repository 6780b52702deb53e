"""Bodies and joints -> links and joints of a description."""

from typing import Any

import numpy as np

from mbd_ros.errors import SceneError
from mbd_ros.scene.models.mjcf.bodies import WORLD, Bodies, Body
from mbd_ros.scene.models.mjcf.joints import Hinge, hinges_of, joint_type
from mbd_ros.scene.models.mjcf.placement import Compiler
from mbd_ros.scene.models.names import Names
from mbd_ros.scene.models.urdf_text import UrdfJoint

UNIVERSE = "universe"
_SAME = 1.0e-14  # of a placement that is none


class Tree:
    """The mechanism of a model.

    One free body that carries all that moves is the base of the robot; other free bodies have six
    joints each.

    Args:
        bodies: The bodies.
        compiler: The settings.

    Attributes:
        links: Names of links, the root first.
        joints: Joints of the description.
        hinges: Those that move, by name.
        given: Name of a joint of the file -> names of its hinges.
        base: Name of the body that moves freely as base of the robot, or empty.

    Raises:
        SceneError: Names file, element and what is wrong.
    """

    def __init__(self, bodies: Bodies, compiler: Compiler) -> None:
        self.bodies, self._compiler = bodies, compiler
        self.hinges: dict[str, Hinge] = {}
        self.given: dict[str, list[str]] = {}
        self.joints: list[UrdfJoint] = []
        self.base = self._free_base()
        self.links = [self.base or WORLD]
        if self.base:
            self.given[bodies.all[self.base].joints[0].item.name] = []
        self._static = self._at_rest()
        own = [one.item.name for _, one in bodies.elements("joints")]
        for name in own:
            if name and own.count(name) > 1:
                raise SceneError(
                    f"{bodies.all[WORLD].item.source}: two joints are called '{name}'"
                )
        self._names = Names(name for name in own if name)
        self._links = Names(bodies.all)
        for body in bodies.all.values():
            if body.name not in (WORLD, self.base) and not (
                self.base and not self.moves(body.name)
            ):
                self._add(body)

    def frame(self, body: str, at: Any) -> tuple[str, Any]:
        """The link that carries a place in a body, and the place in that link."""
        if body in self._static:
            return UNIVERSE, self.bodies.all[body].world * at
        return body, at

    def moves(self, body: str) -> bool:
        """Whether a joint carries a body."""
        return body not in self._static

    def carrier(self, body: str) -> str:
        """The body whose joints carry a body, the world for those at rest."""
        found = self.bodies.all[body]
        while not found.joints and found.parent:
            found = self.bodies.all[found.parent]
        return found.name

    def _at_rest(self) -> set[str]:
        return {name for name in self.bodies.all if self.carrier(name) == WORLD}

    def _free_base(self) -> str:
        """The only body of the world under which something moves, where it is free."""
        tops = list[str]()
        for body in self.bodies.all.values():
            if body.joints and not any(self._is_above(top, body) for top in tops):
                tops.append(body.name)
        if len(tops) != 1 or len(self.bodies.all[tops[0]].joints) != 1:
            return ""
        is_free = joint_type(self.bodies.all[tops[0]].joints[0].item) == "free"
        if is_free and self.bodies.all[tops[0]].parent != WORLD:
            raise self.bodies.all[tops[0]].item.error("a free joint stands in a body of the world")
        return tops[0] if is_free else ""

    def _is_above(self, top: str, body: Body) -> bool:
        name = body.parent
        while name and name != top:
            name = self.bodies.all[name].parent
        return bool(name)

    def _add(self, body: Body) -> None:
        names = [one.item.name or self._names.take(f"{body.name}_joint") for one in body.joints]
        hinges = hinges_of(body, names, self._compiler)
        for name, one in zip(names, body.joints, strict=True):
            self.given[name] = [hinge.name for hinge in hinges if hinge.item is one.item]
        parent, origin = body.parent, body.at
        for i, hinge in enumerate(hinges):
            origin = origin * hinge.before
            is_last = i == len(hinges) - 1 and _is_none(hinge.after)
            child = body.name if is_last else self._links.take(f"{hinge.name}_link")
            self.links.append(child)
            self.hinges[hinge.name] = hinge
            moved = UrdfJoint(hinge.name, parent, child, origin, hinge.motion, hinge.limits)
            self.joints.append(moved)
            parent, origin = child, hinge.after
        if parent != body.name:
            self.links.append(body.name)
            weld = self._names.take(f"{body.name}_weld")
            self.joints.append(UrdfJoint(weld, parent, body.name, origin))


def _is_none(at: Any) -> bool:
    moved = at.homogeneous - np.eye(4)
    return bool(np.abs(moved).max() <= _SAME)
