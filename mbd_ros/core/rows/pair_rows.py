"""Rows that hold a frame on one body to a frame on another."""

from typing import Any

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.parts import Constraint, Row, Wrench
from mbd_ros.core.rows.frame_pair import FramePair, Placed
from mbd_ros.core.rows.rotation_residual import RotationResidual
from mbd_ros.core.state import Array, State

DIRECTIONS = {
    "x": slice(0, 1),
    "y": slice(1, 2),
    "z": slice(2, 3),
    "xy": slice(0, 2),
    "xz": slice(0, 3, 2),
    "yz": slice(1, 3),
    "xyz": slice(0, 3),
}
_ROTATIONS, _ALL = slice(3, 6), slice(0, 6)


class PairRows(Constraint):
    """Origin of b at that of a, in some directions of a; axes as the rotation residual demands.

    Args:
        pair: The frames.
        directions: Key of `DIRECTIONS`: axes of a along which the origins must not part.
        rotation: Residual of the axes; None leaves them free.
    """

    reads = Reads.DRIFT

    def __init__(
        self,
        pair: FramePair,
        directions: str,
        rotation: RotationResidual | None = None,
    ) -> None:
        self._pair = pair
        self._rows, self._rotation = DIRECTIONS[directions], rotation
        self._count = len(directions)
        a, b = pair.a.frame, pair.b.frame
        turns = () if rotation is None else rotation.names
        self.rows = (
            *(Row(f"{a}-{b}.{axis}", "N", a) for axis in directions),
            *(Row(f"{a}-{b}.{axis}", "N·m", a) for axis in turns),
        )

    def residual(self, k: Kinematics, x: State) -> Array:
        """Distances [m] in axes of a, then what the rotation residual measures [rad]."""
        offset = self._pair.offset(k)[self._rows]
        if self._rotation is None:
            return offset
        return np.concatenate((offset, self._rotation.residual(self._pair.rotation(k))))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """dg/dq, shape (m, nv)."""
        return self._jacobian(k, self._placed(k), self._turned(k))

    def drift(self, k: Kinematics, x: State) -> Array:
        """J' v, shape (m,)."""
        return self._drift(k, self._placed(k), self._turned(k))

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, for the placements of one."""
        placed, R = self._placed(k), self._turned(k)
        return self._jacobian(k, placed, R), self._drift(k, placed, R)

    def _placed(self, k: Kinematics) -> Placed | None:
        return self._pair.placed(k) if self._rotation is None else self._pair.place(k)

    def _turned(self, k: Kinematics) -> Any:
        return None if self._rotation is None else self._pair.rotation(k)

    def _jacobian(self, k: Kinematics, placed: Placed | None, R: Any) -> Array:
        if self._rotation is None:
            return self._pair.jacobian(k, placed, self._rows)
        whole = self._pair.jacobian(k, placed, _ALL)
        turns = self._rotation.slope(R).dot(whole[_ROTATIONS])
        return np.concatenate((whole[self._rows], turns))

    def _drift(self, k: Kinematics, placed: Placed | None, R: Any) -> Array:
        if self._rotation is None:
            return self._pair.acceleration(k, placed)[self._rows]
        assert placed is not None
        linear, omega, alpha = self._pair.motion(k, placed)
        return np.concatenate((linear[self._rows], self._rotation.drift(R, omega, alpha)))

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """The wrenches between a and b, at the origin of b: on a, then on b."""
        axes = self._pair.place(k).axes
        force = axes.rotation[:, self._rows].dot(lam[: self._count])
        torque = np.zeros(3)
        if self._rotation is not None:
            slope = self._rotation.slope(self._pair.rotation(k))
            torque = axes.rotation.dot(slope.T.dot(lam[self._count :]))
        point = axes.translation
        return (
            Wrench(self._pair.a.frame, point, -force, -torque),
            Wrench(self._pair.b.frame, point, force, torque),
        )
