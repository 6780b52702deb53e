"""What moves in a robot: joints with one coordinate, and free bases."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import pinocchio as pin

from mbd_ros.core.state import Array


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


def child_link(model: Any, v: int) -> str:
    """Name of the link that a joint carries, whose axes are those of the joint.

    Args:
        model: Pinocchio model.
        v: Index of the coordinate of the joint in a velocity.
    """
    joint = next(i for i, one in enumerate(model.joints) if i and one.idx_v == v)
    links = (f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == joint)
    return str(next(link.name for link in links if link.placement.isIdentity()))


BASE = "base"  # name of the base of the only robot


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


@dataclass(frozen=True)
class Mimic:
    """A `<mimic>` of the description: joint = factor * parent + offset [rad or m]."""

    joint: str
    parent: str
    factor: float
    offset: float


class Rubbing(NamedTuple):
    """A `<dynamics>` of the description.

    Attributes:
        friction: Dry friction [N·m or N].
        damping: Viscous [N·m·s/rad or N·s/m].
    """

    friction: float
    damping: float
