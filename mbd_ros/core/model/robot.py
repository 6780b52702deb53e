"""The robots and bodies of a scene in one Pinocchio model, with their joints."""

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

BASE = "base"  # name of the base of a single robot
FAR = 2.0  # [m]; closer to the origin of the world, rounding errors do not matter
WORLD = "world"  # the fixed frame, like `universe`, unless a link has this name


@dataclass(frozen=True, repr=False)
class Robot:
    """All robots and bodies of a scene, checked and immutable.

    Attributes:
        name: Name in the description.
        model: Pinocchio model of all robots and bodies, with gravity and without locked joints;
            it is shared and must not be modified.
        joints: Joints in the order of their velocity coordinates.
        mimics: The `<mimic>` elements, in topic names.
        bases: Links with a free joint, in the order of their coordinates.
        locked: Position [rad or m] of every joint that was locked and removed.
        fixed: Names of the fixed joints.
        inertia_warnings: Implausible inertias that can be used nevertheless, one line each.
        joint_friction: The `<dynamics>` of joints; it exerts no force unless a part of the scene
            models it.
        ignored: Other contents of the description, which have no effect.
        origin: Point in the world that positions in the model, also those of free bodies, are
            relative to [m], shape (3,): 0, or the first joint of a fixed base if that is more
            than 2 m away.
        model_sources: The descriptions that its robots and bodies were read from.
        places: Points that parts have defined.
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
        """Whether the base is fixed or floating, or which bodies are free, for messages."""
        if not self.bases:
            return "fixed base"
        names = [base.name for base in self.bases]
        return "floating base" if names == [BASE] else f"free: {', '.join(names)}"

    @property
    def floating(self) -> bool:
        """Whether any link has a free joint."""
        return bool(self.bases)

    @property
    def base_v(self) -> NDArray[np.intp]:
        """Indices in v of the velocities of free bases, six each."""
        return np.array(
            [i for base in self.bases for i in range(base.v.start, base.v.stop)], dtype=np.intp
        )

    @property
    def base_titles(self) -> dict[int, str]:
        """Index in v -> title of the free base that has this coordinate, for messages."""
        return {i: base.title for base in self.bases for i in range(base.v.start, base.v.stop)}

    @property
    def members(self) -> frozenset[str]:
        """Names of the robots and bodies with joints; empty for a single robot without a name."""
        return frozenset(joint.member for joint in self.joints if joint.member)

    @property
    def prismatic_joints(self) -> frozenset[str]:
        """Names of the prismatic joints."""
        return frozenset(joint.name for joint in self.joints if joint.kind == "prismatic")

    def joint(self, name: str) -> Joint:
        """Return the joint with a topic name.

        Raises:
            ModelError: The joint does not exist, or it is fixed or locked.
        """
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
        """Return the unit twist of a joint in the axes of its child (linear, angular), (6,)."""
        joint_model = next(j for j in self.model.joints if j.nv == 1 and j.idx_v == joint.v)
        data, q = joint_model.createData(), self.neutral()
        joint_model.calc(data, q, np.zeros(int(self.model.nv)))
        return np.array(data.S, dtype=np.float64).reshape(6)

    def neutral(self) -> Array:
        """Return the configuration with all joints at 0 and all free bases at their initial pose.

        The result is a new array, shape (nq,).
        """
        q: Array = pin.neutral(self.model)
        for base in self.bases:
            q[base.q] = base.start
        return q

    def frame(self, name: str) -> int:
        """Return the index in the model of a link (or frame); `world` is the fixed frame.

        Raises:
            ModelError: There is no such frame; the message lists the links.
        """
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
        """Define a point with axes that is fixed to a link.

        Args:
            frame: Link (or frame) of the point; the root link of a fixed base, `world` or
                `universe` for a point that never moves.
            xyz: Position in `frame` [m], shape (3,).
            rpy: Roll, pitch and yaw of its axes in `frame` as in URDF [rad], shape (3,).
        """
        link = self.model.frames[self.frame(frame)]
        placement = pin.SE3(rotation_matrix(rpy), np.array(xyz, dtype=np.float64))
        return self.places.point(frame, Place(int(link.parentJoint), link.placement * placement))

    def rotated(self, point: Point, rotation: Array) -> Point:
        """Define the same point with axes rotated in its own axes, `rotation` of shape (3, 3)."""
        joint, at = self.places.points[point.number]
        turn = pin.SE3(rotation, np.zeros(3))
        return self.places.point(point.frame, Place(joint, at * turn))

    def shifted(self, point: Point, xyz: Array) -> Point:
        """Define a point with the same axes at the position xyz in these axes [m], shape (3,)."""
        joint, at = self.places.points[point.number]
        return self.places.point(point.frame, Place(joint, at * pin.SE3(np.eye(3), xyz)))

    def carrier(self, frame: str) -> Point:
        """Define the point at the origin, and with the axes, of the joint that carries a link."""
        joint = int(self.model.frames[self.frame(frame)].parentJoint)
        return self.places.point(frame, Place(joint, pin.SE3.Identity()))

    def pair(self, a: Point, b: Point) -> Pair:
        """Define a pair of points, for the motion of b relative to a.

        Raises:
            ModelError: The points have no relative motion.
        """
        return self.places.pair(a, b)

    def inertias(self) -> dict[str, Any]:
        """Return link -> `pinocchio.Inertia` in the axes of the link, zero if it has none."""
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
        max_velocity: Velocity limit [rad/s or m/s], inf where the description has 0 or none.
        max_effort: Effort limit [N·m or N], inf where the description has none.
        member: Name of its robot or body in the scene, empty for a single robot.
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
        """Kind of its effort, torque or force."""
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
    """A root link with a free joint: the floating base of a robot, or a free body.

    Attributes:
        name: `base` for a single robot, otherwise the name of its robot or body.
        q: Slice of its coordinates in a configuration: position relative to `Robot.origin` [m],
            then the quaternion (x, y, z, w).
        v: Slice of its coordinates in a velocity: linear [m/s], then angular [rad/s], in the axes
            of the link.
        joint: Index of its joint in the model.
        frame: Name of the link.
        start: Default initial coordinates, shape (7,).
    """

    name: str
    q: slice
    v: slice
    joint: int
    frame: str
    start: Array

    @property
    def title(self) -> str:
        """Name of the base in messages."""
        return "the floating base" if self.name == BASE else f"free body '{self.name}'"


@dataclass(frozen=True)
class Mimic:
    """A `<mimic>` element of the description: joint = factor * parent + offset [rad or m]."""

    joint: str
    parent: str
    factor: float
    offset: float


class FrictionCoefficients(NamedTuple):
    """A `<dynamics>` element of the description.

    Attributes:
        friction: Coulomb friction [N·m or N].
        damping: Viscous friction coefficient [N·m·s/rad or N·s/m].
    """

    friction: float
    damping: float


class ModelSource(NamedTuple):
    """Description of one robot or body of a scene, with the options for reading it.

    Attributes:
        text: URDF text.
        source: File or topic of the text, for messages.
        base: `fixed`, or `floating` for a root link with a free joint.
        locked: Joint -> position [rad or m] of joints to lock and remove.
        rename: URDF joint name -> topic name.
        inertias: Inertias of links that replace those of the text, see
            `robot_reader.with_inertias`.
        name: Name in the scene; empty for a single robot, whose links and joints keep their names.
        pose: `pinocchio.SE3` of the root link in the world, the initial one if it is free; None
            for the pose in the description.
        shape: Kind and sizes, as a scene writes them, of a body with a single link; None for the
            shapes of the description.
        any_inertias: Whether physically impossible moments of inertia are accepted.
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
        """Return the name in the scene of a joint, or of a link other than the root."""
        return f"{self.name}/{name}" if self.name else name

    def titled(self, text: str) -> str:
        """Return a message with the name of the robot or body before it."""
        return f"{self.name}: {text}" if self.name else text


def child_link(model: Any, v: int) -> str:
    """Return the name of the link that a joint carries and whose axes are those of the joint.

    Args:
        model: Pinocchio model.
        v: Index of the coordinate of the joint in a velocity.
    """
    joint = next(i for i, j in enumerate(model.joints) if i and j.idx_v == v)
    links = (f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == joint)
    return str(next(link.name for link in links if link.placement.isIdentity()))
