"""A scene for other packages: bodies, joints, loops and springs, nothing else."""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array


class Body(NamedTuple):
    """A body and the joint that carries it, whose frame is the frame of the body.

    Attributes:
        name: Of the joint; `base` for a free one.
        parent: Index of the body that carries the joint; 0 is the world.
        place: Frame of the joint in that body at position 0, an SE3.
        axis: In the axes of the joint, shape (3,); zero for a free body.
        slides: Whether the joint is prismatic.
        inertia: Mass, centre and moments in the axes of the joint, a spatial inertia.
        armature: Inertia that a drive adds to the joint [kg·m^2 or kg].
        stiffness: Of springs in the joint [N·m/rad or N/m].
        rest: Position without spring force [rad or m].
        damping: [N·m·s/rad or N·s/m].
        torque: Constant [N·m or N].
    """

    name: str
    parent: int
    place: Any
    axis: Array
    slides: bool
    inertia: Any
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    torque: float = 0.0


class End(NamedTuple):
    """A frame that travels with a body: index of the body, and its place there as SE3."""

    body: int
    place: Any


class Follow(NamedTuple):
    """child = c0 + c1 parent + c2 parent^2 + .., with indices of bodies."""

    child: int
    parent: int
    coefficients: tuple[float, ...]


class Spring(NamedTuple):
    """Spring and damper between two points."""

    a: End
    b: End
    stiffness: float
    damping: float
    length: float


class Task(NamedTuple):
    """A scene for other packages.

    Attributes:
        gravity: [m/s^2], shape (3,).
        bodies: The world's place stands first and is None; parents before children.
        is_floating: Whether body 1 is free: its coordinates come first in q and v.
        q: Assembled start [rad or m], shape (nq,); that of a free body is x, y, z, then the
            quaternion x, y, z, w.
        v: Its velocity, shape (nv,); that of a free body is linear, then angular, in its axes.
        follows: Joints that follow others.
        points: Pairs of frames whose origins coincide.
        welds: Pairs of frames that coincide.
        bars: Pairs of frames whose origins keep a distance [m].
        springs: Springs between points.
    """

    gravity: Array
    bodies: tuple[Body | None, ...]
    is_floating: bool
    q: Array
    v: Array
    follows: tuple[Follow, ...]
    points: tuple[tuple[End, End], ...]
    welds: tuple[tuple[End, End], ...]
    bars: tuple[tuple[End, End, float], ...]
    springs: tuple[Spring, ...]

    @property
    def has_rows(self) -> bool:
        """Whether anything but joints constrains the motion."""
        return bool(self.follows or self.points or self.welds or self.bars)

    @property
    def moving(self) -> tuple[Body, ...]:
        """The bodies without the world."""
        return tuple(body for body in self.bodies if body is not None)

    @property
    def torques(self) -> Array:
        """Constant torques [N·m or N], shape (nv,)."""
        return np.array([0.0] * (6 * self.is_floating) + [body.torque for body in self.joints])

    @property
    def joints(self) -> tuple[Body, ...]:
        """The bodies with one coordinate."""
        return self.moving[int(self.is_floating) :]
