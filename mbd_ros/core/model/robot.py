"""What moves in a scene, checked and frozen: joints, robots and bodies in one Pinocchio model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.points import Pair, Place, Places, Point, rotation_matrix
from mbd_ros.core.model.urdf import inertias_of, parse_urdf, root_link
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

BASE = "base"  # name of the base of the only robot
FAR = 2.0  # m; nearer robots keep the world's origin, and lose no digit that counts
WORLD = "world"  # a frame at rest, beside `universe`, unless a link is called so


@dataclass(frozen=True, repr=False)
class Robot:
    """A robot that passed every check; its model is shared and never written.

    Attributes:
        name: Name in the description.
        model: Pinocchio model of all robots and bodies, gravity set and locked joints removed.
        joints: Joints in the order of their velocity coordinates.
        mimics: The `<mimic>` elements, in topic names.
        bases: Links that move freely, in the order of their coordinates.
        locked: Position [rad or m] of every joint that was frozen and removed.
        fixed: Names of the joints that never move.
        inertia_warnings: Implausible inertias that can be used nevertheless, one line per link.
        joint_friction: The `<dynamics>` of joints; no force until a part of the scene brings it.
        ignored: Other contents of the description, which this package leaves out.
        origin: Point from which positions in the model count, those of free bodies too, in the
            world [m], shape (3,): 0, or the first joint of a fixed base that is more than 2 m
            away.
        model_sources: What its robots and bodies were read from.
        places: Points that parts have asked for.
    """

    name: str
    model: Any
    joints: tuple[Joint, ...]
    mimics: tuple[Mimic, ...]
    bases: tuple[Base, ...]
    locked: Mapping[str, float]
    fixed: frozenset[str]
    inertia_warnings: tuple[str, ...]
    joint_friction: Mapping[str, FrictionCoefficients]
    ignored: tuple[str, ...]
    origin: Array
    model_sources: tuple[ModelSource, ...]
    places: Places = field(compare=False)

    @property
    def source(self) -> str:
        """File or topic of the description, or of the descriptions."""
        return ", ".join(model_source.source for model_source in self.model_sources)

    @property
    def base_text(self) -> str:
        """What moves freely, in words."""
        if not self.bases:
            return "fixed base"
        names = [base.name for base in self.bases]
        return "floating base" if names == [BASE] else f"free: {', '.join(names)}"

    @property
    def floating(self) -> bool:
        """Whether anything moves freely."""
        return bool(self.bases)

    @property
    def base_v(self) -> NDArray[np.intp]:
        """Where the velocities of free bases stand in v, six each."""
        return np.array(
            [i for base in self.bases for i in range(base.v.start, base.v.stop)], dtype=np.intp
        )

    @property
    def base_titles(self) -> dict[int, str]:
        """Where in v free bases have coordinates -> what messages call them."""
        return {i: base.title for base in self.bases for i in range(base.v.start, base.v.stop)}

    @property
    def members(self) -> frozenset[str]:
        """Names of the robots and bodies with joints; none for the only robot."""
        return frozenset(joint.member for joint in self.joints if joint.member)

    @property
    def prismatic_joints(self) -> frozenset[str]:
        """Names of the joints that slide."""
        return frozenset(joint.name for joint in self.joints if joint.kind == "prismatic")

    def joint(self, name: str) -> Joint:
        """Joint of that topic name; a ModelError where it is missing, fixed or locked."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        if name in self.locked:
            raise ModelError(f"joint '{name}' is locked at {self.locked[name]:g}")
        if name in self.fixed:
            raise ModelError(f"joint '{name}' is fixed")
        existing = ", ".join(joint.name for joint in self.joints) or "none"
        raise ModelError(f"no joint '{name}'; the robot has {existing}")

    def axis(self, joint: Joint) -> Array:
        """Unit motion of a joint in the axes of its child: linear, then angular, shape (6,)."""
        mine = next(j for j in self.model.joints if j.nv == 1 and j.idx_v == joint.v)
        data, q = mine.createData(), self.neutral()
        mine.calc(data, q, np.zeros(int(self.model.nv)))
        return np.array(data.S, dtype=np.float64).reshape(6)

    def neutral(self) -> Array:
        """Configuration with every joint at 0 and every base at its start, shape (nq,), fresh."""
        q: Array = pin.neutral(self.model)
        for base in self.bases:
            q[base.q] = base.start
        return q

    def frame(self, name: str) -> int:
        """Index in the model of the link (or frame) of that name; `world` is at rest."""
        index = int(self.model.getFrameId(name, pin.FrameType.BODY))
        if index == len(self.model.frames):
            index = int(self.model.getFrameId(name))
        if index == len(self.model.frames) and name == WORLD:
            return 0
        if index == len(self.model.frames):
            bodies = [f.name for f in self.model.frames if f.type == pin.FrameType.BODY]
            raise ModelError(f"no frame '{name}'; the links are {', '.join(bodies)}")
        return index

    def point(
        self,
        frame: str,
        xyz: Sequence[float] = (0.0, 0.0, 0.0),
        rpy: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> Point:
        """A point that travels with a link.

        Args:
            frame: Link (or frame) that carries it; the root link of a fixed base, `world` or
                `universe` for one at rest.
            xyz: Where it is in `frame` [m], shape (3,).
            rpy: Roll, pitch and yaw of its axes in `frame` as in URDF [rad], shape (3,).
        """
        link = self.model.frames[self.frame(frame)]
        there = pin.SE3(rotation_matrix(rpy), np.array(xyz, dtype=np.float64))
        return self.places.point(frame, Place(int(link.parentJoint), link.placement * there))

    def rotated(self, point: Point, rotation: Array) -> Point:
        """The same point with axes that are turned in its own, rotation of shape (3, 3)."""
        joint, at = self.places.points[point.number]
        turn = pin.SE3(rotation, np.zeros(3))
        return self.places.point(point.frame, Place(joint, at * turn))

    def shifted(self, point: Point, xyz: Array) -> Point:
        """A point with the same axes, at a place in these axes [m], shape (3,)."""
        joint, at = self.places.points[point.number]
        return self.places.point(point.frame, Place(joint, at * pin.SE3(np.eye(3), xyz)))

    def carrier(self, frame: str) -> Point:
        """Origin and axes of the joint that carries a link."""
        joint = int(self.model.frames[self.frame(frame)].parentJoint)
        return self.places.point(frame, Place(joint, pin.SE3.Identity()))

    def pair(self, a: Point, b: Point) -> Pair:
        """Point b as an observer on a sees it.

        Raises:
            ModelError: They do not move against each other.
        """
        return self.places.pair(a, b)

    def inertias(self) -> dict[str, Any]:
        """Link -> `pinocchio.Inertia` in the axes of the link, 0 where it has none."""
        inertias = {}
        for model_source in self.model_sources:
            tree = parse_urdf(model_source.text, model_source.source, model_source.inertias)
            root = root_link(tree)
            for link, inertia in inertias_of(tree).items():
                is_named = link == root and bool(model_source.name)
                inertias[model_source.name if is_named else model_source.scoped(link)] = inertia
        return inertias

    def __repr__(self) -> str:
        mass = pin.computeTotalMass(self.model)
        names = shorten(", ".join(joint.name for joint in self.joints), 200, placeholder=" ..")
        return (
            f"Robot '{self.name}' from {self.source}\n"
            f"  {self.base_text}, {mass:.6g} kg, joints ({len(self.joints)}): {names}"
        )


@dataclass(frozen=True)
class Joint:
    """One joint with one coordinate.

    Attributes:
        name: Name on topics, bags and CSV columns.
        urdf_name: Name in the robot description.
        kind: revolute, continuous or prismatic.
        q: Index of its coordinate in a configuration.
        v: Index of its coordinate in a velocity.
        lower: Lower position limit [rad or m], -inf without one.
        upper: Upper position limit [rad or m], inf without one.
        max_velocity: [rad/s or m/s], inf where the description says 0 or nothing.
        max_effort: [N·m or N], inf where the description says nothing (continuous joints may).
        member: Name of its robot or body in the scene, empty for the only robot.
    """

    name: str
    urdf_name: str
    kind: str
    q: int
    v: int
    lower: float
    upper: float
    max_velocity: float
    max_effort: float
    member: str = ""

    @property
    def effort_name(self) -> str:
        """What its effort is, torque or force."""
        return "force" if self.kind == "prismatic" else "torque"

    @property
    def effort_unit(self) -> str:
        """Unit of its effort."""
        return "N" if self.kind == "prismatic" else "N·m"

    @property
    def position_unit(self) -> str:
        """Unit of its position."""
        return "m" if self.kind == "prismatic" else "rad"


class Base(NamedTuple):
    """A link that moves freely, and carries the links that hang on it.

    Attributes:
        name: `base` for the base of the only robot, else the name of its robot or body.
        q: Its coordinates in a configuration: position less `Robot.origin` [m], then the
            quaternion (x, y, z, w).
        v: Its coordinates in a velocity: linear [m/s], then angular [rad/s], in its own axes.
        joint: Index of its joint in the model.
        frame: Name of the link.
        start: Where it starts unless a scene says otherwise, as in a configuration, shape (7,).
    """

    name: str
    q: slice
    v: slice
    joint: int
    frame: str
    start: Array

    @property
    def title(self) -> str:
        """For messages."""
        return "the floating base" if self.name == BASE else f"free body '{self.name}'"


@dataclass(frozen=True)
class Mimic:
    """A `<mimic>` of the description: joint = factor * parent + offset [rad or m]."""

    joint: str
    parent: str
    factor: float
    offset: float


class FrictionCoefficients(NamedTuple):
    """A `<dynamics>` of the description.

    Attributes:
        friction: Dry friction [N·m or N].
        damping: Viscous [N·m·s/rad or N·s/m].
    """

    friction: float
    damping: float


class ModelSource(NamedTuple):
    """One robot or body of a scene, before it is read.

    Attributes:
        source: File or topic of the text, for the messages.
        base: `fixed`, or `floating` for a root link that moves freely.
        locked: Joint -> position [rad or m] of joints to freeze and remove.
        rename: URDF joint name -> the name that it goes by.
        inertias: Of links, in place of those of the text, see `robot_reader.with_inertias`.
        name: In the scene; empty for the only robot, whose links and joints keep their names.
        pose: `pinocchio.SE3` of the root link in the world, at the start if that moves freely;
            None where the description says.
        shape: Kind and sizes, as a scene writes them, of a body that has only one link; None
            where the description says.
        any_inertias: Whether moments of inertia that no body has are taken as they are.
    """

    text: str
    source: str
    base: str = "fixed"
    locked: Mapping[str, float] | None = None
    rename: Mapping[str, str] | None = None
    inertias: Mapping[str, Any] | None = None
    name: str = ""
    pose: Any = None
    shape: tuple[str, Any] | None = None
    any_inertias: bool = False

    def scoped(self, name: str) -> str:
        """What a joint, or a link that is not the root, is called in the scene."""
        return f"{self.name}/{name}" if self.name else name

    def titled(self, text: str) -> str:
        """A remark or message about the member, with its name before it."""
        return f"{self.name}: {text}" if self.name else text


def child_link(model: Any, v: int) -> str:
    """Name of the link that a joint carries, whose axes are those of the joint.

    Args:
        v: Index of the coordinate of the joint in a velocity.
    """
    joint = next(i for i, one in enumerate(model.joints) if i and one.idx_v == v)
    links = (f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == joint)
    return str(next(link.name for link in links if link.placement.isIdentity()))
