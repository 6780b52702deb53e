"""Wrench on a link that follows a table over time."""

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.wrenches import ExternalWrench
from mbd_ros.core.parts import Load, Wrench
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class PrescribedWrench(Load):
    """A wrench read from a table, tau = J' w(t): straight lines between samples.

    The load is zero before the first and after the last sample, so it jumps there unless the table
    begins and ends with zeros. Frame, axes, point and threshold are those of an external wrench:
    with `expressed_in` at rest, the force stays at one place while the link moves.

    Args:
        robot: Robot of the scene.
        frame: Link that carries the load.
        times: Times of the samples [s], strictly increasing, shape (n,), n >= 2.
        wrenches: Force [N] then torque [N·m], one row a sample, shape (n, 6).
        expressed_in: Frame whose axes and, without `point`, whose origin the load refers to;
            `frame` by default, `universe` for the world of a robot that names none.
        point: Point that the torque is taken about, in `expressed_in` [m], shape (3,).
        threshold: Force norm below which the load counts as zero [N], >= 0.

    Raises:
        ModelError: Unknown frame, negative threshold, or a table that is not one.
    """

    reads = Reads.JACOBIAN
    example = {
        "frame": "foot",
        "times": [0.0, 0.5, 1.0],
        "wrenches": [[10.0, 0, 50, 0, 0, 0], [0, 0, 80, 0, 5, 0], [0, 0, 0, 0, 0, 0]],
    }

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        times: Sequence[float],
        wrenches: Sequence[Sequence[float]],
        expressed_in: str | None = None,
        point: Sequence[float] = (0.0, 0.0, 0.0),
        threshold: float = 0.0,
    ) -> None:
        self._load = ExternalWrench(
            robot, frame=frame, expressed_in=expressed_in, point=point, threshold=threshold
        )
        stamps, self._wrenches = _table(times, wrenches)
        self._times: list[float] = stamps.tolist()
        self._slopes = np.diff(self._wrenches, axis=0) / np.diff(stamps)[:, None]
        self._model, self._nv = robot.model, int(robot.model.nv)

    def wrench(self, t: float) -> Array:
        """Force [N] and torque [N·m] of the table at a time [s], shape (6,)."""
        i = bisect_right(self._times, t) - 1
        if 0 <= i < len(self._slopes):
            between: Array = self._wrenches[i] + (t - self._times[i]) * self._slopes[i]
            return between
        if t == self._times[-1]:
            return np.array(self._wrenches[-1])
        return np.zeros(6)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        wrench = self.wrench(x.t)
        if self._load.body == 0 or not self._load.is_loaded(wrench):
            return np.zeros(self._nv)
        jacobian = pin.getJointJacobian(self._model, k.data, self._load.body, pin.LOCAL)
        load = self._load.in_body(k.data, wrench).vector
        tau: Array = load.dot(jacobian.reshape(6, self._nv))  # with one joint it is a vector
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The load on the link, about the origin of the joint that carries it."""
        wrench = self.wrench(x.t)
        if not self._load.is_loaded(wrench):
            return ()
        place = k.data.oMi[self._load.body]
        load = self._load.in_body(k.data, wrench)
        force, torque = place.rotation.dot(load.linear), place.rotation.dot(load.angular)
        return (Wrench(self._load.frame, place.translation, force, torque),)


def _table(times: Sequence[float], wrenches: Sequence[Sequence[float]]) -> tuple[Array, Array]:
    stamps = np.array(times, dtype=np.float64)
    if stamps.ndim != 1 or len(stamps) < 2:
        raise ModelError(f"times: shape {stamps.shape}, accepted: two or more numbers")
    if not (np.isfinite(stamps).all() and (np.diff(stamps) > 0).all()):
        raise ModelError("times must be finite and strictly increasing")
    if len(wrenches) != len(stamps):
        raise ModelError(f"wrenches: {len(wrenches)} rows for {len(stamps)} times")
    for i, row in enumerate(wrenches):
        if len(row) != 6:
            raise ModelError(f"wrenches[{i}]: {len(row)} numbers, accepted: 6")
    rows = np.array(wrenches, dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise ModelError(f"wrenches[{bad[0]}] {rows[bad[0]]} must be finite")
    return stamps, rows
