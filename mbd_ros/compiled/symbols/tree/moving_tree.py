"""The links of a tree at symbolic positions, in their own axes or in those of the world.

`WorldFrames` finds where links are and how they move, in axes of the world, when it is asked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.tree import link_rotations as turns
from mbd_ros.compiled.symbols.tree.link_rotations import (
    NO_VECTOR,
    ONE,
    ZERO,
    Matrix,
    PlaneTurn,
    Turn,
    Vector,
    cross,
    plus,
)
from mbd_ros.compiled.symbols.tree.links import (
    FREE,
    PRISMATIC,
    REVOLUTE,
    Link,
    Tree,
    cosine_and_sine,
)

_UP: Vector = (ZERO, ZERO, ONE)
WORLD = -1  # stands for the link of what is at rest


class Placed(NamedTuple):
    """A link at a configuration, in the axes that its tree was asked for.

    Attributes:
        turn: From its axes to those of its parent; none where all are those of the world.
        offset: Its origin from that of its parent, in axes of the parent [m].
        axis: Of its joint, in its axes.
        h: Mass times mass centre [kg·m].
        I: Inertia about its origin [kg·m^2].
        R: From its axes to those of the world; None where nobody needs it.
    """

    link: Link
    turn: Turn
    offset: Vector
    axis: Vector
    h: Vector
    I: Matrix  # noqa: E741
    R: Matrix | None


def in_own_axes(tree: Tree, q: Any) -> list[Placed]:
    """Every link in its own axes."""
    bodies = []
    for link, (turn, offset) in zip(tree.links, placements(tree, q), strict=True):
        inertia = turns.vector(link.inertia.h), turns.matrix(link.inertia.I)
        bodies.append(Placed(link, turn, offset, _UP, *inertia, None))
    return bodies


def in_world_axes(tree: Tree, q: Any) -> list[Placed]:
    """Every link in the axes of the world, about its own origin; for trees without free bodies."""
    bodies: list[Placed] = []
    for link, (turn, offset) in zip(tree.links, placements(tree, q), strict=True):
        before = turns.EYE if link.parent < 0 else bodies[link.parent].R
        assert before is not None
        R, displacement = turns.product(before, turn), turns.through(before, offset)
        h = turns.through(R, turns.vector(link.inertia.h))
        about = turns.matrix_tensor(R, turns.matrix(link.inertia.I))
        axis = turns.through(R, _UP)
        bodies.append(Placed(link, (), displacement, axis, h, about, R))
    return bodies


def placements(tree: Tree, q: Any) -> list[tuple[Turn, Vector]]:
    """Turn to the axes of the parent, and offset there, of every link with one coordinate.

    Args:
        q: Configuration, one SX scalar an entry.
    """
    return [_placement(link, q) for link in tree.links]


def _placement(link: Link, q: Any) -> tuple[Turn, Vector]:
    if link.kind == FREE:
        R = rotation_of(q[link.q + 3 : link.q + 7])
        return (turns.MatrixTurn(R),), tuple(q[link.q : link.q + 3])
    position = q[link.q]
    before = [*_constant(2, link.beta), *_constant(0, link.alpha)]
    offset = turns.vector(link.offset)
    if link.kind == PRISMATIC:
        whole = [*before, *_constant(2, link.gamma)]
        displacement = turns.out(whole, (ZERO, ZERO, position))
        return whole, turns.plus(offset, displacement)
    return [*before, _about_axis(position, link.gamma)], offset


def rotation_of(quaternion: Any) -> Matrix:
    """Rotation matrix of a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


def _constant(axis: int, angle: float) -> Turn:
    c, s = cosine_and_sine(angle)
    return () if (c, s) == (1.0, 0.0) else (PlaneTurn(axis, turns.known(c), turns.known(s)),)


def _about_axis(angle: Any, offset: float) -> PlaneTurn:
    """A turn about z, of sine and cosine of the angle alone where the offset is a right one."""
    c, s = (turns.known(one) for one in cosine_and_sine(offset))
    if c is not ZERO and s is not ZERO:
        return PlaneTurn(2, ca.cos(angle + offset), ca.sin(angle + offset))
    ahead = PlaneTurn(2, ca.cos(angle), ca.sin(angle)).vector((c, s, ZERO))
    return PlaneTurn(2, ahead[0], ahead[1])


class WorldFrames:
    """Frames of all links.

    Args:
        q: Configuration, one SX scalar an entry.
    """

    def __init__(self, tree: Tree, q: Sequence[Any], v: Sequence[Any]) -> None:
        self._links, self._q, self._v = tree.links, q, v
        self._placed = placements(tree, q)
        self.axes, self.displacement, self.motion = map(
            cache, (self._axes, self._displacement, self._motion)
        )

    def above(self, link: int) -> Iterator[int]:
        """A link and all below it, down to the one that stands on the world."""
        while link != WORLD:
            yield link
            link = self._links[link].parent

    def link(self, number: int) -> Link:
        """The link of a number."""
        return self._links[number]

    def common(self, a: int, b: int) -> int:
        """The last link that carries both."""
        below = {*self.above(a), WORLD}
        return next((link for link in self.above(b) if link in below), WORLD)

    def levers(self, link: int, offset: Vector, down_to: int = WORLD) -> Iterator[Any]:
        """Links that carry a point, and the vector from the origin of each to it.

        Args:
            link: The link that holds it.
            offset: From the origin of that link, in axes of the world.
            down_to: The first one that is not asked for.
        """
        while link != down_to:
            yield link, offset
            offset = plus(self.displacement(link), offset)
            link = self._links[link].parent

    def from_link(self, below: int, link: int, offset: Vector) -> Vector:
        """From the origin of a link that carries a point to the point; see `levers`."""
        while link != below:
            offset = plus(self.displacement(link), offset)
            link = self._links[link].parent
        return offset

    def columns(self, link: int, lever: Vector) -> list[tuple[Vector, Vector]]:
        """Linear and angular velocity of a point by the velocities of one joint.

        Args:
            link: The link of the joint.
            lever: From the origin of the link to the point.
        """
        R = self.axes(link)
        axes = turns.transposed(R)
        if self._links[link].kind == FREE:
            turned = [(cross(axis, lever), axis) for axis in axes]
            return [*((axis, NO_VECTOR) for axis in axes), *turned]
        if self._links[link].kind == REVOLUTE:
            return [(cross(axes[2], lever), axes[2])]
        return [(axes[2], NO_VECTOR)]

    def _axes(self, link: int) -> Matrix:
        """From the axes of a link to those of the world."""
        if link == WORLD:
            return turns.EYE
        return turns.product(self.axes(self._links[link].parent), self._placed[link][0])

    def _displacement(self, link: int) -> Vector:
        """From the origin of the parent to that of a link."""
        return turns.through(self.axes(self._links[link].parent), self._placed[link][1])

    def _motion(self, number: int) -> Moving:
        if number == WORLD:
            return Moving(NO_VECTOR, NO_VECTOR, NO_VECTOR, NO_VECTOR)
        link, R = self._links[number], self.axes(number)
        if link.kind == FREE:
            velocity = turns.through(R, tuple(self._v[link.v : link.v + 3]))
            spin = turns.through(R, tuple(self._v[link.v + 3 : link.v + 6]))
            return Moving(spin, velocity, NO_VECTOR, cross(spin, velocity))
        before, displacement = self.motion(link.parent), self.displacement(number)
        spin, turning = before.spin, before.turning
        velocity = plus(before.velocity, cross(spin, displacement))
        carried = turns.through(turns.bend(spin, turning), displacement)
        acceleration = plus(before.acceleration, carried)
        along = turns.times(self._v[link.v], turns.transposed(R)[2])
        across = cross(spin, along)
        if link.kind == REVOLUTE:
            return Moving(plus(spin, along), velocity, plus(turning, across), acceleration)
        acceleration = plus(acceleration, turns.times(ca.SX(2.0), across))
        return Moving(spin, plus(velocity, along), turning, acceleration)


class Moving(NamedTuple):
    """Motion of a link at zero joint acceleration.

    Attributes:
        spin: Angular velocity [rad/s].
        velocity: Of the origin [m/s].
        turning: Rate of the angular velocity [rad/s^2].
        acceleration: Of the origin [m/s^2].
    """

    spin: Vector
    velocity: Vector
    turning: Vector
    acceleration: Vector
