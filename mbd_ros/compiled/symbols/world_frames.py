"""Where links are and how they move, in axes of the world, found when it is asked for."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols import link_rotations as turns
from mbd_ros.compiled.symbols.inertias import FREE, REVOLUTE
from mbd_ros.compiled.symbols.link_rotations import NO_VECTOR, Matrix, Vector, cross, plus
from mbd_ros.compiled.symbols.links import Link, Tree
from mbd_ros.compiled.symbols.moving_tree import placements

WORLD = -1  # stands for the link of what is at rest


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


class WorldFrames:
    """Frames of all links.

    Args:
        tree: The links.
        q: Configuration, one SX scalar an entry.
        v: Velocity, the same.
    """

    def __init__(self, tree: Tree, q: Sequence[Any], v: Sequence[Any]) -> None:
        self._links, self._q, self._v = tree.links, q, v
        self._placed = placements(tree, q)
        self.axes, self.way, self.motion = map(cache, (self._axes, self._way, self._motion))

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
            offset = plus(self.way(link), offset)
            link = self._links[link].parent

    def from_link(self, below: int, link: int, offset: Vector) -> Vector:
        """From the origin of a link that carries a point to the point; see `levers`."""
        while link != below:
            offset = plus(self.way(link), offset)
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

    def _way(self, link: int) -> Vector:
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
        before, way = self.motion(link.parent), self.way(number)
        spin, turning = before.spin, before.turning
        velocity = plus(before.velocity, cross(spin, way))
        carried = turns.through(turns.bend(spin, turning), way)
        acceleration = plus(before.acceleration, carried)
        along = turns.times(self._v[link.v], turns.transposed(R)[2])
        across = cross(spin, along)
        if link.kind == REVOLUTE:
            return Moving(plus(spin, along), velocity, plus(turning, across), acceleration)
        acceleration = plus(acceleration, turns.times(ca.SX(2.0), across))
        return Moving(spin, plus(velocity, along), turning, acceleration)
