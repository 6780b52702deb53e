"""Kinematics k of symbols: what parts ask of the mechanism while they are traced."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols import link_rotations as turns
from mbd_ros.compiled.symbols.arrays import matrix, objects, vector
from mbd_ros.compiled.symbols.link_rotations import ZERO, Matrix, Vector
from mbd_ros.compiled.symbols.links import Tree
from mbd_ros.compiled.symbols.moving_tree import in_own_axes
from mbd_ros.compiled.symbols.pair_motion import SymbolicPairMotion
from mbd_ros.compiled.symbols.scalar import Scalar, function, plain, where
from mbd_ros.compiled.symbols.searched_paths import SearchedPaths
from mbd_ros.compiled.symbols.tree_forces import joint_forces, needed
from mbd_ros.compiled.symbols.world_frames import WORLD, WorldFrames
from mbd_ros.core.model.points import Pair, Point
from mbd_ros.core.model.robot import Robot


class SymbolicKinematics:
    """Answers as `Kinematics` does, in arrays of numbers that may be `Scalar`.

    Args:
        robot: The robot.
        tree: Its links.
        q: Configuration of all joints, an array of objects.
        v: Velocity, the same.
    """

    item = staticmethod(np.ndarray.item)
    dot: Callable[..., Any] = staticmethod(np.ndarray.dot)
    array: Callable[..., Any] = staticmethod(np.array)
    where = staticmethod(where)
    sqrt = staticmethod(function(ca.sqrt, math.sqrt))
    exp = staticmethod(function(ca.exp, math.exp))
    log = staticmethod(function(ca.log, math.log))
    tanh = staticmethod(function(ca.tanh, math.tanh))
    sin = staticmethod(function(ca.sin, math.sin))
    cos = staticmethod(function(ca.cos, math.cos))
    maximum = staticmethod(function(ca.fmax, max))
    minimum = staticmethod(function(ca.fmin, min))
    copysign = staticmethod(function(ca.copysign, math.copysign))
    arctan2 = staticmethod(function(ca.atan2, math.atan2))

    def __init__(self, robot: Robot, tree: Tree, q: Any, v: Any) -> None:
        self._robot, self._tree = robot, tree
        self._q, self._v = ([ca.SX(plain(one)) for one in given] for given in (q, v))
        self.frames = WorldFrames(tree, self._q, self._v)
        self._pairs: dict[int, SymbolicPairMotion] = {}
        self.searches = SearchedPaths()

    def position(self, point: Point) -> Any:
        """As `Kinematics.position`."""
        return vector(self.frames.from_link(WORLD, *self.held(point)))

    def rotation(self, point: Point) -> Any:
        """As `Kinematics.rotation`."""
        return matrix(self.axes(point))

    def velocity(self, point: Point) -> Any:
        """As `Kinematics.velocity`."""
        link, offset = self.held(point)
        moving = self.frames.motion(link)
        return vector(turns.plus(moving.velocity, turns.cross(moving.spin, offset)))

    def acceleration(self, point: Point) -> Any:
        """As `Kinematics.acceleration`."""
        link, offset = self.held(point)
        moving = self.frames.motion(link)
        bent = turns.through(turns.bend(moving.spin, moving.turning), offset)
        return vector(turns.plus(moving.acceleration, bent))

    def jacobian(self, point: Point) -> Any:
        """As `Kinematics.jacobian`."""
        return self.spatial_jacobian(point)[:3].copy()

    def spatial_jacobian(self, point: Point) -> Any:
        """As `Kinematics.spatial_jacobian`."""
        return self._columns(point, lambda v: v)

    def own_jacobian(self, point: Point) -> Any:
        """As `Kinematics.own_jacobian`."""
        to_own = turns.transposed(self.axes(point))
        return self._columns(point, lambda v: turns.through(to_own, v))

    def motion(self, pair: Pair) -> SymbolicPairMotion:
        """As `Kinematics.motion`."""
        if pair.number not in self._pairs:
            self._pairs[pair.number] = SymbolicPairMotion(self, pair)
        return self._pairs[pair.number]

    def carried(self, wrench: Any, a: Point, b: Point) -> Any:
        """As `Kinematics.carried`."""
        given = [ca.SX(plain(one)) for one in wrench]
        R, to_b = self.axes(a), turns.transposed(self.axes(b))
        force, torque = (turns.through(R, tuple(part)) for part in (given[:3], given[3:]))
        about = turns.plus(torque, turns.cross(self.between(b, a), force))
        return np.concatenate([vector(turns.through(to_b, part)) for part in (force, about)])

    def gravity(self, q: Any) -> Any:
        """As `Kinematics.gravity`."""
        at = [ca.SX(plain(one)) for one in q]
        placed, still = in_own_axes(self._tree, at), [ZERO] * self._tree.nv
        on_links = needed(self._tree, placed, still, None, turns.vector(-self._tree.gravity))
        return objects(joint_forces(self._tree, placed, on_links))

    def searched(self, path: Any, x: Any) -> Any:
        """As `Kinematics.searched`."""
        return self.searches.taut(path, self, x)

    @cached_property
    def nv(self) -> int:
        """Size of a velocity."""
        return self._tree.nv

    def held(self, point: Point) -> tuple[int, Vector]:
        """The link that holds a point, and where from its origin, in axes of the world."""
        link, place = self._seen(point)
        axes = self.frames.axes(link)
        return link, turns.through(axes, turns.vector(place.translation))

    def place_of(self, link: int) -> tuple[Vector, Vector]:
        """Where the origin of a link is, and mass times mass centre from there, world axes."""
        frames, h = self.frames, self._tree.links[link].inertia.h
        moment = turns.through(frames.axes(link), turns.vector(h))
        return frames.from_link(WORLD, link, turns.NO_VECTOR), moment

    def axes(self, point: Point) -> Matrix:
        """From the axes of a point to those of the world."""
        link, place = self._seen(point)
        rows, columns = self.frames.axes(link), turns.transposed(turns.matrix(place.rotation))
        return tuple(  # type: ignore[return-value]
            tuple(turns.dot(row, column) for column in columns) for row in rows
        )

    def between(self, a: Point, b: Point) -> Vector:
        """From point a to point b, in axes of the world."""
        held_a, held_b = self.held(a), self.held(b)
        below = self.frames.common(held_a[0], held_b[0])
        ends = (self.frames.from_link(below, *held) for held in (held_b, held_a))
        return turns.minus(*ends)

    def _seen(self, point: Point) -> tuple[int, Any]:
        joint, at = self._robot.places.points[point.number]
        if joint == 0:
            return WORLD, at
        return joint - 1, self._tree.links[joint - 1].seat.actInv(at)

    def _columns(self, point: Point, seen: Callable[[Vector], Vector]) -> Any:
        whole = self.zeros((6, self._tree.nv))
        for link, lever in self.frames.levers(*self.held(point)):
            first = self.frames.link(link).v
            for i, parts in enumerate(self.frames.columns(link, lever), first):
                whole[:3, i], whole[3:, i] = (vector(seen(part)) for part in parts)
        return whole

    @staticmethod
    def zeros(shape: Any) -> Any:
        """As numpy's, and open to symbols."""
        found = np.empty(shape, dtype=object)
        found.fill(0.0)
        return found

    @classmethod
    def within(cls, values: Any, lower: Any, upper: Any) -> Any:
        """As `Kinematics.within`; bounds may be one a value."""
        found = values.copy()
        bounds = (np.broadcast_to(one, found.shape).tolist() for one in (lower, upper))
        for i, (low, high) in enumerate(zip(*bounds, strict=True)):
            found[i] = found[i] if _is_open(low) else cls.maximum(found[i], low)
            found[i] = found[i] if _is_open(high) else cls.minimum(found[i], high)
        return found

    @classmethod
    def choose(cls, least: Any, most: Any, first: Any, second: Any) -> Any:
        """As `Kinematics.choose`."""
        columns = (cls.spread(one, len(least)) for one in (least, most, first, second))
        chosen = [where(a <= b, one, other) for a, b, one, other in zip(*columns, strict=True)]
        return np.array(chosen, dtype=object)

    @staticmethod
    def spread(value: Any, count: int) -> list[Any]:
        """One number, or one each, as a list."""
        given = np.asarray(value, dtype=object)
        return np.broadcast_to(given, count).tolist()

    @staticmethod
    def row(one: Any) -> Any:
        """As `Kinematics.row`."""
        return one.reshape(1, -1)

    @staticmethod
    def any(values: Any) -> bool:
        """As `Kinematics.any`."""
        return any(isinstance(one, Scalar) or one != 0.0 for one in values.tolist())

    @staticmethod
    def hypot(line: Any) -> Any:
        """Length of a vector."""
        return SymbolicKinematics.sqrt(line.dot(line))

    @staticmethod
    def piece(x: Any, breaks: Sequence[Any], rows: Sequence[Sequence[Any]]) -> Sequence[Any]:
        """As `Kinematics.piece`."""
        chosen = list(rows[0])
        for left, row in zip(breaks, rows[1:], strict=True):
            after = x >= left
            chosen = [where(after, new, old) for new, old in zip(row, chosen, strict=True)]
        return chosen

    @staticmethod
    def either(condition: Any, first: Callable[[], Any], second: Callable[[], Any]) -> Any:
        """Both where nobody knows which; of tuples entry by entry."""
        if not isinstance(condition, Scalar):
            return first() if condition else second()
        one, other = first(), second()
        if not isinstance(one, tuple):
            return where(condition, one, other)
        return tuple(where(condition, *both) for both in zip(one, other, strict=True))


def _is_open(bound: Any) -> bool:
    return not isinstance(bound, Scalar) and math.isinf(bound)
