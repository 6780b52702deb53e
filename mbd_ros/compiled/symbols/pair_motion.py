"""Motion of a point seen from another body, in symbols."""

from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols import link_rotations as turns
from mbd_ros.compiled.symbols.arrays import matrix, vector
from mbd_ros.compiled.symbols.link_rotations import Vector, cross, minus, plus
from mbd_ros.compiled.symbols.scalar import column, numbers
from mbd_ros.core.kinematics.relative_motion import OfPose, Pose
from mbd_ros.core.model.points import Pair

if TYPE_CHECKING:
    from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics


class SymbolicPairMotion:
    """Answers as `PairMotion` does; whatever the placements, they are found again.

    Args:
        k: Kinematics of symbols.
        pair: The observer a and what is observed, b.
    """

    def __init__(self, k: "SymbolicKinematics", pair: Pair) -> None:
        self._k, self._pair = k, pair
        self._to_a = turns.transposed(k.axes(pair.a))

    def offset(self) -> Any:
        """As `PairMotion.offset`."""
        between = self._k.between(self._pair.a, self._pair.b)
        return vector(turns.through(self._to_a, between))

    def rotation(self) -> Any:
        """As `PairMotion.rotation`."""
        columns = turns.transposed(self._k.axes(self._pair.b))
        turned = [turns.through(self._to_a, column) for column in columns]
        return matrix(turns.transposed(tuple(turned)))  # type: ignore[arg-type]

    def pose(self) -> Any:
        """As `PairMotion.pose`."""
        return Pose(self.rotation(), self.offset())

    def placed(self) -> Any:
        """None for an observer at rest."""
        return self.place() if self._pair.a.moves else None

    def place(self) -> Any:
        """Whatever the other methods are given."""
        return self

    def jacobian(self, placed: Any, rows: Any) -> Any:
        """As `PairMotion.jacobian`."""
        k, (_, a, b, signs) = self._k, self._pair
        frames, whole = k.frames, k.zeros((6, k.nv))
        (on_a, _), (on_b, offset) = k.held(a), k.held(b)
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
                seen = [vector(turns.through(self._to_a, part)) for part in parts]
                whole[:, i] = np.concatenate(seen) * float(signs[i])
        return whole[rows]

    def acceleration(self, placed: Any) -> Any:
        """As `PairMotion.acceleration`."""
        return self.motion(placed)[0]

    def motion(self, placed: Any) -> tuple[Any, Any, Any]:
        """As `PairMotion.motion`."""
        _, a, omega, alpha = self.moving(placed)
        return a, omega, alpha

    def moving(self, placed: Any) -> tuple[Any, Any, Any, Any]:
        """As `PairMotion.moving`."""
        seen = (vector(turns.through(self._to_a, part)) for part in self._relative())
        v, a, omega, alpha = seen
        return v, a, omega, alpha

    def along(
        self, function: OfPose, pose: Pose, rates: Pose
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """As `PairMotion.along`, by derivatives of the function."""
        at, along = ca.SX.sym("at", 12), ca.SX.sym("along", 12)
        rotation, translation = numbers(at[:9]).reshape(3, 3), numbers(at[9:])
        found = [np.asarray(one, dtype=object) for one in function(Pose(rotation, translation))]
        values = column(np.concatenate([one.ravel() for one in found]))
        slopes = ca.jtimes(values, at, along)
        asked = ca.Function("along", [at, along], [ca.densify(values), ca.densify(slopes)])
        answers = asked(
            *(column([*one.rotation.ravel(), *one.translation]) for one in (pose, rates))
        )
        first, second = (_like(found, numbers(answer)) for answer in answers)
        return first, second

    def _relative(self) -> tuple[Vector, Vector, Vector, Vector]:
        """Velocity, acceleration, angular velocity and its rate of b past a, world axes.

        With the velocity of a point that a carries where b is, v = v_b - v_a, and the derivative
        that an observer on a sees is v' - w_a x v.
        """
        k, frames = self._k, self._k.frames
        (on_a, at_a), (on_b, at_b) = k.held(self._pair.a), k.held(self._pair.b)
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
    ends = np.cumsum([one.size for one in shapes])
    parts = np.split(flat, ends[:-1])
    return tuple(part.reshape(one.shape) for part, one in zip(parts, shapes, strict=True))


def _velocity(moving: Any, offset: Vector) -> Vector:
    return plus(moving.velocity, cross(moving.spin, offset))


def _acceleration(moving: Any, offset: Vector) -> Vector:
    bent = turns.through(turns.bend(moving.spin, moving.turning), offset)
    return plus(moving.acceleration, bent)
