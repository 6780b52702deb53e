"""Kinematics k of symbols: what parts ask of the mechanism while they are traced."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.scalar import (
    Scalar,
    column,
    function,
    matrix,
    numbers,
    objects,
    plain,
    where,
)
from mbd_ros.compiled.symbols.searched_paths import SearchedPaths
from mbd_ros.compiled.symbols.tree import link_rotations as turns
from mbd_ros.compiled.symbols.tree.link_rotations import ZERO, Matrix, Vector, cross, minus, plus
from mbd_ros.compiled.symbols.tree.links import Tree
from mbd_ros.compiled.symbols.tree.moving_tree import WORLD, WorldFrames, in_own_axes
from mbd_ros.compiled.symbols.tree.newton_euler import joint_forces, needed
from mbd_ros.core.kinematics.relative_motion import OfPose, Pose
from mbd_ros.core.model.points import Pair, Point
from mbd_ros.core.model.robot import Robot


class SymbolicKinematics:
    """Answers as `Kinematics` does, in arrays of numbers that may be `Scalar`.

    Args:
        q: Configuration of all joints, an array of objects.
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
        self._q, self._v = ([ca.SX(plain(entry)) for entry in given] for given in (q, v))
        self.frames = WorldFrames(tree, self._q, self._v)
        self._pairs: dict[int, SymbolicPairMotion] = {}
        self.searches = SearchedPaths()

    def position(self, point: Point) -> Any:
        """Where a point is, less `Robot.origin` [m], shape (3,)."""
        return objects(self.frames.from_link(WORLD, *self.link_and_offset(point)))

    def rotation(self, point: Point) -> Any:
        """From the axes of a point to those of the world, shape (3, 3)."""
        return matrix(self.axes(point))

    def velocity(self, point: Point) -> Any:
        """Velocity of a point [m/s], shape (3,)."""
        link, offset = self.link_and_offset(point)
        moving = self.frames.motion(link)
        return objects(turns.plus(moving.velocity, turns.cross(moving.spin, offset)))

    def acceleration(self, point: Point) -> Any:
        """Second derivative of a position at zero joint acceleration [m/s^2], shape (3,)."""
        link, offset = self.link_and_offset(point)
        moving = self.frames.motion(link)
        bent = turns.through(turns.bend(moving.spin, moving.turning), offset)
        return objects(turns.plus(moving.acceleration, bent))

    def jacobian(self, point: Point) -> Any:
        """From joint velocities to that of a point, shape (3, nv)."""
        return self.spatial_jacobian(point)[:3].copy()

    def spatial_jacobian(self, point: Point) -> Any:
        """From joint velocities to velocity and angular velocity of a point, shape (6, nv)."""
        return self._columns(point, lambda v: v)

    def local_jacobian(self, point: Point) -> Any:
        """The `spatial_jacobian` in the axes of the point, shape (6, nv)."""
        to_own = turns.transposed(self.axes(point))
        return self._columns(point, lambda v: turns.through(to_own, v))

    def motion(self, pair: Pair) -> SymbolicPairMotion:
        """Motion of b as an observer on a sees it."""
        if pair.number not in self._pairs:
            self._pairs[pair.number] = SymbolicPairMotion(self, pair)
        return self._pairs[pair.number]

    def transform_wrench(self, wrench: Any, a: Point, b: Point) -> Any:
        """A wrench about a in the axes of a, as one about b in the axes of b, shape (6,)."""
        given = [ca.SX(plain(entry)) for entry in wrench]
        R, to_b = self.axes(a), turns.transposed(self.axes(b))
        force, torque = (turns.through(R, tuple(part)) for part in (given[:3], given[3:]))
        about = turns.plus(torque, turns.cross(self.between(b, a), force))
        return np.concatenate([objects(turns.through(to_b, part)) for part in (force, about)])

    def gravity(self, q: Any) -> Any:
        """Generalized force that holds the robot still, shape (nv,)."""
        at = [ca.SX(plain(entry)) for entry in q]
        placed, still = in_own_axes(self._tree, at), [ZERO] * self._tree.nv
        on_links = needed(self._tree, placed, still, None, turns.vector(-self._tree.gravity))
        return objects(joint_forces(self._tree, placed, on_links))

    def search_path(self, path: Any, x: Any) -> Any:
        """Return the result of a path search at a state, which is left to native code."""
        return self.searches.taut(path, self, x)

    @cached_property
    def nv(self) -> int:
        """Size of a velocity."""
        return self._tree.nv

    def link_and_offset(self, point: Point) -> tuple[int, Vector]:
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
        held_a, held_b = self.link_and_offset(a), self.link_and_offset(b)
        below = self.frames.common(held_a[0], held_b[0])
        ends = (self.frames.from_link(below, *held) for held in (held_b, held_a))
        return turns.minus(*ends)

    def _seen(self, point: Point) -> tuple[int, Any]:
        joint, at = self._robot.places.points[point.number]
        if joint == 0:
            return WORLD, at
        return joint - 1, self._tree.links[joint - 1].seat.actInv(at)

    def _columns(self, point: Point, seen: Callable[[Vector], Vector]) -> Any:
        jacobian = self.zeros((6, self._tree.nv))
        for link, lever in self.frames.levers(*self.link_and_offset(point)):
            first = self.frames.link(link).v
            for i, parts in enumerate(self.frames.columns(link, lever), first):
                jacobian[:3, i], jacobian[3:, i] = (objects(seen(part)) for part in parts)
        return jacobian

    @staticmethod
    def zeros(shape: Any) -> Any:
        """An array of zeros that takes symbols."""
        array = np.empty(shape, dtype=object)
        array.fill(0.0)
        return array

    @classmethod
    def within(cls, values: Any, lower: Any, upper: Any) -> Any:
        """Values moved into their bounds, one pair for all or one a value."""
        clamped = values.copy()
        bounds = (np.broadcast_to(entry, clamped.shape).tolist() for entry in (lower, upper))
        for i, (low, high) in enumerate(zip(*bounds, strict=True)):
            clamped[i] = clamped[i] if _is_open(low) else cls.maximum(clamped[i], low)
            clamped[i] = clamped[i] if _is_open(high) else cls.minimum(clamped[i], high)
        return clamped

    @classmethod
    def choose(cls, least: Any, most: Any, first: Any, second: Any) -> Any:
        """Entry by entry the first value where `least` is not above `most`, else the second."""
        columns = (cls.spread(entry, len(least)) for entry in (least, most, first, second))
        chosen = [where(a <= b, entry, other) for a, b, entry, other in zip(*columns, strict=True)]
        return np.array(chosen, dtype=object)

    @staticmethod
    def spread(value: Any, count: int) -> list[Any]:
        """One number, or one each, as a list."""
        given = np.asarray(value, dtype=object)
        return np.broadcast_to(given, count).tolist()

    @staticmethod
    def row(entry: Any) -> Any:
        """A vector as the only row of a matrix, shape (1, n)."""
        return entry.reshape(1, -1)

    @staticmethod
    def any(values: Any) -> bool:
        """Whether a value is not zero; where nobody can know, it may be so."""
        return any(isinstance(entry, Scalar) or entry != 0.0 for entry in values.tolist())

    @staticmethod
    def hypot(line: Any) -> Any:
        """Length of a vector."""
        return SymbolicKinematics.sqrt(line.dot(line))

    @staticmethod
    def piece(x: Any, breaks: Sequence[Any], rows: Sequence[Sequence[Any]]) -> Sequence[Any]:
        """The row of the interval that x is in; at a break that of the interval after it."""
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
        entry, other = first(), second()
        if not isinstance(entry, tuple):
            return where(condition, entry, other)
        return tuple(where(condition, *both) for both in zip(entry, other, strict=True))


def _is_open(bound: Any) -> bool:
    return not isinstance(bound, Scalar) and math.isinf(bound)


class SymbolicPairMotion:
    """Motion of b as an observer on a sees it; answers as `PairMotion` does.

    Args:
        pair: The observer a and what is observed, b.
    """

    def __init__(self, k: SymbolicKinematics, pair: Pair) -> None:
        self._k, self._pair = k, pair
        self._to_a = turns.transposed(k.axes(pair.a))

    def offset(self) -> Any:
        """Origin of b, from that of a [m], shape (3,)."""
        between = self._k.between(self._pair.a, self._pair.b)
        return objects(turns.through(self._to_a, between))

    def rotation(self) -> Any:
        """From the axes of b to those of a, shape (3, 3)."""
        columns = turns.transposed(self._k.axes(self._pair.b))
        rotated = [turns.through(self._to_a, column) for column in columns]
        return matrix(turns.transposed(tuple(rotated)))  # type: ignore[arg-type]

    def pose(self) -> Any:
        """Rotation and origin of b in the axes of a."""
        return Pose(self.rotation(), self.offset())

    def placed(self) -> Any:
        """None for an observer at rest."""
        return self.place() if self._pair.a.moves else None

    def place(self) -> Any:
        """Whatever the other methods are given."""
        return self

    def jacobian(self, placed: Any, rows: Any) -> Any:
        """From joint velocities to rows of the velocity, shape (m, nv)."""
        k, (_, a, b, signs) = self._k, self._pair
        frames, jacobian = k.frames, k.zeros((6, k.nv))
        (on_a, _), (on_b, offset) = k.link_and_offset(a), k.link_and_offset(b)
        below = frames.common(on_a, on_b)
        from_below = frames.from_link(below, on_b, offset)
        levers = list(frames.levers(on_b, offset, below))
        for link in frames.above(on_a):
            if link == below:
                break
            back = minus(from_below, frames.from_link(below, link, turns.NO_VECTOR))
            levers.append((link, back))
        for link, lever in levers:
            first = frames.link(link).v
            for i, parts in enumerate(frames.columns(link, lever), first):
                seen = [objects(turns.through(self._to_a, part)) for part in parts]
                jacobian[:, i] = np.concatenate(seen) * float(signs[i])
        return jacobian[rows]

    def acceleration(self, placed: Any) -> Any:
        """Second derivative of the offset at zero joint acceleration, shape (3,)."""
        return self.motion(placed)[0]

    def motion(self, placed: Any) -> tuple[Any, Any, Any]:
        """Acceleration of the offset, angular velocity and its derivative, shape (3,) each."""
        _, a, omega, alpha = self.velocity_and_motion(placed)
        return a, omega, alpha

    def velocity_and_motion(self, placed: Any) -> tuple[Any, Any, Any, Any]:
        """The velocity of the origin of b, then what `motion` gives, shape (3,) each."""
        seen = (objects(turns.through(self._to_a, part)) for part in self._relative())
        v, a, omega, alpha = seen
        return v, a, omega, alpha

    def directional_derivative(
        self, function: OfPose, pose: Pose, rates: Pose
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Values of a function of a pose, and their rates by its derivatives."""
        at, along = ca.SX.sym("at", 12), ca.SX.sym("along", 12)
        rotation, translation = numbers(at[:9]).reshape(3, 3), numbers(at[9:])
        results = [
            np.asarray(entry, dtype=object) for entry in function(Pose(rotation, translation))
        ]
        values = column(np.concatenate([entry.ravel() for entry in results]))
        slopes = ca.jtimes(values, at, along)
        derivative = ca.Function("along", [at, along], [ca.densify(values), ca.densify(slopes)])
        answers = derivative(
            *(column([*entry.rotation.ravel(), *entry.translation]) for entry in (pose, rates))
        )
        first, second = (_like(results, numbers(answer)) for answer in answers)
        return first, second

    def _relative(self) -> tuple[Vector, Vector, Vector, Vector]:
        """Velocity, acceleration, angular velocity and its rate of b past a, world axes.

        With the velocity of a point that a carries where b is, v = v_b - v_a, and the derivative
        that an observer on a sees is v' - w_a x v.
        """
        k, frames = self._k, self._k.frames
        (on_a, at_a), (on_b, at_b) = (
            k.link_and_offset(self._pair.a),
            k.link_and_offset(self._pair.b),
        )
        a, b = frames.motion(on_a), frames.motion(on_b)
        there = plus(at_a, k.between(self._pair.a, self._pair.b))  # from the origin of a
        moved = minus(_velocity(b, at_b), _velocity(a, there))
        bent = minus(_acceleration(b, at_b), _acceleration(a, there))
        linear = minus(bent, cross(plus(a.spin, a.spin), moved))
        spin = minus(b.spin, a.spin)
        turning = minus(minus(b.turning, a.turning), cross(a.spin, spin))
        return moved, linear, spin, turning


def _like(shapes: list[Any], flat: Any) -> tuple[Any, ...]:
    """Arrays of given shapes out of one column."""
    ends = np.cumsum([entry.size for entry in shapes])
    parts = np.split(flat, ends[:-1])
    return tuple(part.reshape(entry.shape) for part, entry in zip(parts, shapes, strict=True))


def _velocity(moving: Any, offset: Vector) -> Vector:
    return plus(moving.velocity, cross(moving.spin, offset))


def _acceleration(moving: Any, offset: Vector) -> Vector:
    bent = turns.through(turns.bend(moving.spin, moving.turning), offset)
    return plus(moving.acceleration, bent)
