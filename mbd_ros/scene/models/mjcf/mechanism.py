"""Joints of bodies -> joints and links of a description, and the forces in them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.urdf import MAX_LINKS
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.models.mjcf.bodies import WORLD, Bodies, Body, Placed
from mbd_ros.scene.models.mjcf.item import Compiler, Item, unit
from mbd_ros.scene.models.urdf_text import IDENTITY, Motion, Names, UrdfJoint, X, Y, Z, is_identity

_TYPES = ("hinge", "slide", "ball", "free")
_JOINT = (
    *("name", "class", "type", "group", "pos", "axis", "springdamper", "solreflimit"),
    *("solimplimit", "solreffriction", "solimpfriction", "stiffness", "range", "limited"),
    *("actuatorfrcrange", "actuatorfrclimited", "actuatorgravcomp", "margin", "ref"),
    *("springref", "armature", "damping", "frictionloss", "user", "align"),
)
_FREE = ("name", "class", "group", "align")
_PASSIVE = ("stiffness", "damping", "frictionloss", "armature")
UNIVERSE = "universe"


class Tree:
    """The mechanism of a model.

    One free body that carries all that moves is the base of the robot; other free bodies have six
    joints each.

    Attributes:
        links: Names of links, the root first.
        joints: Joints of the description.
        hinges: Those that move, by name.
        joint_names: Name of a joint of the file -> names of its hinges.
        base: Name of the body that moves freely as base of the robot, or empty.

    Raises:
        SceneError: Names file, element and what is wrong.
    """

    def __init__(self, bodies: Bodies, compiler: Compiler) -> None:
        self.bodies, self._compiler = bodies, compiler
        self.hinges: dict[str, Hinge] = {}
        self.joint_names: dict[str, list[str]] = {}
        self.joints: list[UrdfJoint] = []
        self.base = self._free_base()
        self.links = [self.base or WORLD]
        if self.base:
            self.joint_names[bodies.all[self.base].joints[0].item.name] = []
        self._static = self._at_rest()
        joint_names = [one.item.name for _, one in bodies.elements("joints")]
        source = bodies.all[WORLD].item.source
        if len(joint_names) > MAX_LINKS:
            raise SceneError(f"{source}: {len(joint_names)} joints, accepted are {MAX_LINKS}")
        for name, count in Counter(joint_names).items():
            if name and count > 1:
                raise SceneError(f"{source}: two joints are called '{name}'")
        self._names = Names(name for name in joint_names if name)
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
        carrier_body = self.bodies.all[body]
        while not carrier_body.joints and carrier_body.parent:
            carrier_body = self.bodies.all[carrier_body.parent]
        return carrier_body.name

    def _at_rest(self) -> set[str]:
        return {name for name in self.bodies.all if self.carrier(name) == WORLD}

    def _free_base(self) -> str:
        """The only body of the world under which something moves, where it is free."""
        tops, carried = list[str](), set[str]()
        for body in self.bodies.all.values():
            if body.parent in carried or body.joints:
                tops += [] if body.parent in carried else [body.name]
                carried.add(body.name)
        if len(tops) != 1 or len(self.bodies.all[tops[0]].joints) != 1:
            return ""
        is_free = joint_type(self.bodies.all[tops[0]].joints[0].item) == "free"
        if is_free and self.bodies.all[tops[0]].parent != WORLD:
            raise self.bodies.all[tops[0]].item.error("a free joint stands in a body of the world")
        return tops[0] if is_free else ""

    def _add(self, body: Body) -> None:
        names = [one.item.name or self._names.take(f"{body.name}_joint") for one in body.joints]
        hinges = hinges_of(body, names, self._compiler)
        for name, one in zip(names, body.joints, strict=True):
            self.joint_names[name] = [hinge.name for hinge in hinges if hinge.item is one.item]
        parent, origin = body.parent, body.at
        for i, hinge in enumerate(hinges):
            origin = origin * hinge.before
            is_last = i == len(hinges) - 1 and is_identity(hinge.after)
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


def hinges_of(body: Body, names: Sequence[str], compiler: Compiler) -> list[Hinge]:
    """Coordinates of the joints of a body, in their order.

    Args:
        names: Of its joints.

    Raises:
        SceneError: A free joint beside others or inside another body, or values that are wrong.
    """
    hinges = list[Hinge]()
    for (item, frame), name in zip(body.joints, names, strict=True):
        kind = joint_type(item)
        if kind == "free" and (len(body.joints) > 1 or body.parent != "world"):
            raise item.error("a free joint stands alone, in a body of the world")
        if kind in ("free", "ball"):
            hinges += _free(item, name, body.at) if kind == "free" else _ball(item, name, frame)
        else:
            hinges.append(_hinge(Placed(item, frame), name, kind == "hinge", compiler))
    return hinges


class Hinge(NamedTuple):
    """A coordinate: a joint of the description.

    Attributes:
        name: Its name in the scene.
        motion: What it does.
        before: `pinocchio.SE3` of the joint in the body, as the joints before it moved that.
        after: From the joint back to the body.
        limits: Smallest and largest position [rad or m], or None.
        ref: Position at the reference pose [rad or m].
        rest: Position without force of its spring [rad or m].
    """

    item: Item
    name: str
    motion: Motion
    before: Any
    after: Any
    limits: tuple[float, float] | None = None
    ref: float = 0.0
    rest: float = 0.0


def joint_type(item: Item) -> str:
    """Return the type of a joint; a `<freejoint>` is free.

    Raises:
        SceneError: An unknown one, or unknown attributes.
    """
    if item.type == "freejoint":
        item.only(_FREE)
        return "free"
    return item.only(_JOINT).choice("type", _TYPES)


def _hinge(placed: Placed, name: str, turns: bool, compiler: Compiler) -> Hinge:
    item, frame = placed
    unit_of_angle = compiler.degree if turns else 1.0
    axis = frame.rotation @ unit(item, np.array(item.vector("axis", (0.0, 0.0, 1.0))), "axis")
    anchor = frame.act(np.array(item.vector("pos", (0.0, 0.0, 0.0)))) if turns else np.zeros(3)
    ref = unit_of_angle * item.number("ref", 0.0)
    motion = Motion(name, axis, turns, IDENTITY, name)
    at = pin.SE3(np.eye(3), anchor)
    limits = None
    if item.is_limited("limited", "range", compiler.autolimits):
        lower, upper = (unit_of_angle * end for end in item.vector("range", (0.0, 0.0)))
        if not lower < upper:
            raise item.error(f"range is '{item.text('range')}', its ends must increase")
        limits = lower, upper
    rest = unit_of_angle * item.number("springref", 0.0)
    return Hinge(item, name, motion, at * motion.at(-ref), at.inverse(), limits, ref, rest)


def _ball(item: Item, name: str, frame: Any) -> list[Hinge]:
    """Three hinges about x, y and z of the body."""
    at = pin.SE3(np.eye(3), frame.act(np.array(item.vector("pos", (0.0, 0.0, 0.0)))))
    none = pin.SE3.Identity()
    return [
        Hinge(
            item,
            f"{name}_{letter}",
            Motion(f"{name}_{letter}", axis, True, IDENTITY, f"{name}_{letter}"),
            at if letter == "x" else none,
            at.inverse() if letter == "z" else none,
        )
        for letter, axis in zip("xyz", (X, Y, Z), strict=True)
    ]


def _free(item: Item, name: str, at: Any) -> list[Hinge]:
    """Three slides along the axes of the world, then three hinges about those of the body."""
    none = pin.SE3.Identity()
    start: Array = at.translation
    slides = [
        Hinge(
            item,
            f"{name}_t{letter}",
            Motion("", axis, False, IDENTITY, f"{name}_t{letter}"),
            at.inverse() if letter == "x" else none,
            pin.SE3(at.rotation, np.zeros(3)) if letter == "z" else none,
            ref=float(begin),
        )
        for letter, axis, begin in zip("xyz", (X, Y, Z), start, strict=True)
    ]
    turns = [
        Hinge(item, f"{name}_r{letter}", Motion("", axis, True, IDENTITY, ""), none, none)
        for letter, axis in zip("xyz", (X, Y, Z), strict=True)
    ]
    return [*slides, *turns]


def passive(hinge: Hinge) -> list[dict[str, Any]]:
    """Entries of `forces`: spring, damper and friction of a hinge or slide.

    Raises:
        SceneError: One of them is negative.
    """
    item, friction = hinge.item, dict[str, float]()
    values = {key: item.vector(key, [0.0] * 3, 1)[0] for key in _PASSIVE[:3]}
    for key, value in values.items():
        if value < 0.0:
            raise item.error(f"{key} is negative")
    spring = values["stiffness"]
    entries: list[dict[str, Any]] = []
    if spring:
        entry = {"stiffness": spring, "rest": hinge.rest, "damping": values["damping"]}
        kept = {key: value for key, value in entry.items() if value}
        entries.append({"type": "joint_spring", "joint": hinge.name, **kept})
    else:
        friction["viscous"] = values["damping"]
    friction["coulomb"] = values["frictionloss"]
    friction = {key: value for key, value in friction.items() if value}
    if friction:
        entries.append({"type": "joint_friction", "joint": hinge.name, **friction})
    return entries


def unexpressed(item: Item) -> str:
    """Return the attributes of a joint that a scene cannot express, empty for most joints."""
    kind, reasons = joint_type(item), list[str]()
    if kind in ("free", "ball"):
        reasons = [key for key in _PASSIVE if item.type != "freejoint" and _is_there(item, key)]
        reasons += ["range"] if kind == "ball" and "range" in item else []
    else:
        reasons = [
            f"{key} beyond its first number"
            for key in ("stiffness", "damping")
            if any(item.vector(key, [0.0] * 3, 1)[1:])
        ]
        reasons += ["springdamper"] if _is_there(item, "springdamper") else []
    return ", ".join(reasons)


def _is_there(item: Item, key: str) -> bool:
    return key in item and any(item.numbers(key, 1, 3))
