"""What moves in a scene, checked and frozen: robots and bodies in one Pinocchio model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import shorten
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.joints import BASE, Base, Joint, Mimic, Rubbing
from mbd_ros.core.model.model_source import Recipe
from mbd_ros.core.model.points import Pair, Place, Places, Point, rotation_matrix
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

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
        doubts: Inertias that no body has and that can be used nevertheless, a line a link.
        rubbing: The `<dynamics>` of joints; no force until a part of the scene brings it.
        ignored: Other contents of the description, which this package leaves out.
        origin: Point from which positions in the model count, those of free bodies too, in the
            world [m], shape (3,): 0, or the first joint of a fixed base that is more than 2 m
            away.
        recipes: What its robots and bodies were read from.
        places: Points that parts have asked for.
    """

    name: str
    model: Any
    joints: tuple[Joint, ...]
    mimics: tuple[Mimic, ...]
    bases: tuple[Base, ...]
    locked: Mapping[str, float]
    fixed: frozenset[str]
    doubts: tuple[str, ...]
    rubbing: Mapping[str, Rubbing]
    ignored: tuple[str, ...]
    origin: Array
    recipes: tuple[Recipe, ...]
    places: Places = field(compare=False)

    @property
    def source(self) -> str:
        """File or topic of the description, or of the descriptions."""
        return ", ".join(recipe.source for recipe in self.recipes)

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
        return np.array([i for base in self.bases for i in _places(base.v)], dtype=np.intp)

    @property
    def base_titles(self) -> dict[int, str]:
        """Where in v free bases have coordinates -> what messages call them."""
        return {i: base.title for base in self.bases for i in _places(base.v)}

    @property
    def members(self) -> frozenset[str]:
        """Names of the robots and bodies with joints; none for the only robot."""
        return frozenset(joint.member for joint in self.joints if joint.member)

    @property
    def sliding(self) -> frozenset[str]:
        """Names of the joints that slide."""
        return frozenset(joint.name for joint in self.joints if joint.kind == "prismatic")

    def joint(self, name: str) -> Joint:
        """Joint of that topic name.

        Raises:
            ModelError: There is none, or it is fixed or locked; the message lists what exists.
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
        """Index in the model of the link (or frame) of that name; `world` is at rest.

        Raises:
            ModelError: There is none; the message lists the links.
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
        """A point that travels with a link.

        Args:
            frame: Link (or frame) that carries it; the root link of a fixed base, `world` or
                `universe` for one at rest.
            xyz: Where it is in `frame` [m], shape (3,).
            rpy: Roll, pitch and yaw of its axes in `frame` as in URDF [rad], shape (3,).

        Raises:
            ModelError: Unknown frame.
        """
        link = self.model.frames[self.frame(frame)]
        there = pin.SE3(rotation_matrix(rpy), np.array(xyz, dtype=np.float64))
        return self.places.point(frame, Place(int(link.parentJoint), link.placement * there))

    def turned(self, point: Point, rotation: Array) -> Point:
        """The same point with axes that are turned in its own, rotation of shape (3, 3)."""
        joint, at = self.places.points[point.number]
        turn = pin.SE3(rotation, np.zeros(3))
        return self.places.point(point.frame, Place(joint, at * turn))

    def shifted(self, point: Point, xyz: Array) -> Point:
        """A point with the same axes, at a place in these axes [m], shape (3,)."""
        joint, at = self.places.points[point.number]
        return self.places.point(point.frame, Place(joint, at * pin.SE3(np.eye(3), xyz)))

    def carrier(self, frame: str) -> Point:
        """Origin and axes of the joint that carries a link.

        Raises:
            ModelError: Unknown frame.
        """
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
        from mbd_ros.core.model.members import inertias_of_links

        return inertias_of_links(self.recipes)

    def with_inertias(self, inertias: Mapping[str, Any]) -> "Robot":
        """The robot with other inertias of some links, checked as those of a description.

        Args:
            inertias: Link -> `pinocchio.Inertia` or (mass [kg], mass centre [m], shape (3,),
                inertia about the mass centre [kg·m^2], shape (3, 3)), both in the axes of the
                link. Locked and fixed links are links too.

        Raises:
            ModelError: Names link, value and condition.
        """
        from mbd_ros.core.model.members import with_inertias
        from mbd_ros.core.model.robot_reader import read_robots

        recipes = with_inertias(self.recipes, inertias)
        robot = read_robots(recipes, self.model.gravity.linear.tolist())
        robot.model.armature = self.model.armature.copy()  # of drives, which no description has
        return robot

    def __repr__(self) -> str:
        mass = pin.computeTotalMass(self.model)
        names = shorten(", ".join(joint.name for joint in self.joints), 200, placeholder=" ..")
        return (
            f"Robot '{self.name}' from {self.source}\n"
            f"  {self.base_text}, {mass:.6g} kg, joints ({len(self.joints)}): {names}"
        )


def _places(of: slice) -> range:
    return range(of.start, of.stop)
