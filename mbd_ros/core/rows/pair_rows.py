"""Rows that hold a frame on one body to a frame on another."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.contracts.outputs import Now, Value, exerted_on
from mbd_ros.core.contracts.parts import Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.relative_motion import PairMotion, Placed
from mbd_ros.core.model.points import Pair, Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.rows.rotation_residual import RotationResidual
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

DIRECTIONS: dict[str, Any] = {
    "x": slice(0, 1),
    "y": slice(1, 2),
    "z": slice(2, 3),
    "xy": slice(0, 2),
    "xz": slice(0, 3, 2),
    "yz": slice(1, 3),
    "xyz": slice(0, 3),
    "zxy": [2, 0, 1],
}
_ROTATIONS, _ALL = slice(3, 6), slice(0, 6)


class PairRows(Constraint):
    """Origin of b at that of a, in some directions of a; axes as the rotation residual demands.

    Args:
        pair: Frame a and frame b.
        directions: Key of `DIRECTIONS`: axes of a along which the origins must not part.
        rotation: Residual of the axes; None leaves them free.
    """

    reads = Reads.DRIFT

    def __init__(
        self,
        pair: Pair,
        directions: str,
        rotation: RotationResidual | None = None,
    ) -> None:
        self._pair = pair
        self._rows, self._rotation = DIRECTIONS[directions], rotation
        self._count = len(directions)
        a, turns = pair.a.frame, () if rotation is None else rotation.names
        self.rows = (
            *(Row(f"force_{axis}", "N", a) for axis in directions),
            *(Row(f"torque_{axis}", "N·m", a) for axis in turns),
        )
        self.outputs = (exerted_on(pair.a, pair.b), exerted_on(pair.b, pair.b))

    def residual(self, k: Kinematics, x: State) -> Array:
        """Distances [m] in axes of a, then what the rotation residual measures [rad]."""
        seen = k.motion(self._pair)
        offset = seen.offset()[self._rows]
        if self._rotation is None:
            return offset
        return np.concatenate((offset, self._rotation.residual(seen.rotation())))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """dg/dq, shape (m, nv)."""
        seen = k.motion(self._pair)
        return self._jacobian(seen, self._placed(seen), self._turned(seen))

    def drift(self, k: Kinematics, x: State) -> Array:
        """J' v, shape (m,)."""
        seen = k.motion(self._pair)
        return self._drift(seen, self._placed(seen), self._turned(seen))

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, for the placements of one."""
        seen = k.motion(self._pair)
        placed, R = self._placed(seen), self._turned(seen)
        return self._jacobian(seen, placed, R), self._drift(seen, placed, R)

    def _placed(self, seen: PairMotion) -> Placed | None:
        return seen.placed() if self._rotation is None else seen.place()

    def _turned(self, seen: PairMotion) -> Any:
        return None if self._rotation is None else seen.rotation()

    def _jacobian(self, seen: PairMotion, placed: Placed | None, R: Any) -> Array:
        if self._rotation is None:
            return seen.jacobian(placed, self._rows)
        whole = seen.jacobian(placed, _ALL)
        turns = self._rotation.slope(R).dot(whole[_ROTATIONS])
        return np.concatenate((whole[self._rows], turns))

    def _drift(self, seen: PairMotion, placed: Placed | None, R: Any) -> Array:
        if self._rotation is None:
            return seen.acceleration(placed)[self._rows]
        assert placed is not None
        linear, omega, alpha = seen.motion(placed)
        return np.concatenate((linear[self._rows], self._rotation.drift(R, omega, alpha)))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """The wrenches between a and b."""
        return [wrench.numbers for wrench in self.wrenches(k, x, now.lam)]

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """The wrenches between a and b, at the origin of b: on a, then on b."""
        _, a, b, _ = self._pair
        axes, point = k.rotation(a), k.position(b)
        force = axes[:, self._rows].dot(lam[: self._count])
        torque = np.zeros(3)
        if self._rotation is not None:
            slope = self._rotation.slope(k.motion(self._pair).rotation())
            torque = axes.dot(slope.T.dot(lam[self._count :]))
        return Wrench(a.frame, point, -force, -torque), Wrench(b.frame, point, force, torque)


def check_normal(normal: Sequence[float]) -> None:
    """Refuse a normal that points nowhere.

    Raises:
        ModelError: Names it.
    """
    if not any(normal):
        raise ModelError(f"normal {normal} must have a direction")


def plane_of(robot: Robot, point: Point, normal: Sequence[float]) -> Point:
    """The point of a plane, with z along a normal that stands in its axes."""
    along = np.array(normal, dtype=np.float64)
    along = along / np.abs(along).max()  # so that its square neither vanishes nor overflows
    return robot.turned(point, _turned(along / np.linalg.norm(along)))


def _turned(normal: Array) -> Array:
    """A rotation whose z axis is the normal."""
    x = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = x - normal * normal.dot(x)
    x /= np.linalg.norm(x)
    a, b, c = normal.tolist()
    across = np.array(((0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0)))
    return np.column_stack((x, across.dot(x), normal))
