"""trajectory_msgs/JointTrajectory <-> arrays: trajectories, and states with accelerations."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.cdr import ENCAPSULATION, STAMP, after_text
from msg_adapters.errors import MessageError, require_finite
from msg_adapters.time import NANOSECONDS, read_time, write_time

MOST_POINTS = 3000
_MOST_NAMES = 4000
_FIELDS = ("positions", "velocities", "accelerations", "effort")


def read_joint_trajectory(msg: Any) -> Trajectory:
    """Arrays of one message.

    Raises:
        MessageError: More than `MOST_POINTS` points, points without names, or an array neither
            left out by all points nor as long as the names in each.
    """
    names, points = tuple(msg.joint_names), msg.points
    if not points:
        return Trajectory(
            read_time(msg.header.stamp), names, np.zeros(0), np.zeros((0, len(names))), None, None
        )
    require_few(len(points))
    if not names:
        raise MessageError("no joint names")
    times = [p.time_from_start.sec + p.time_from_start.nanosec / NANOSECONDS for p in points]
    position = _table(points, "positions", len(names))
    if position is None:
        raise MessageError("points without positions")
    return Trajectory(
        read_time(msg.header.stamp),
        names,
        np.array(times),
        position,
        _table(points, "velocities", len(names)),
        _table(points, "accelerations", len(names)),
    )


class Trajectory(NamedTuple):
    """A trajectory of joints through points; without a point it asks to stop.

    Attributes:
        stamp: Header stamp [ns]; 0 means now.
        names: Joints, one a column.
        times: Of the points after the stamp [s], shape (k,).
        position: [rad or m], shape (k, n).
        velocity: [rad/s or m/s], shape (k, n); None where no point gives one.
        acceleration: [rad/s^2 or m/s^2], shape (k, n); None where no point gives one.
    """

    stamp: int
    names: tuple[str, ...]
    times: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64] | None
    acceleration: NDArray[np.float64] | None


def _table(points: Sequence[Any], field: str, size: int) -> NDArray[np.float64] | None:
    lengths = {len(getattr(point, field)) for point in points}
    if lengths == {0}:
        return None
    if lengths != {size}:
        raise MessageError(f"{field} of {sorted(lengths)} values for {size} joint names")
    return np.array([list(getattr(point, field)) for point in points], dtype=np.float64)


def require_few(points: int) -> None:
    """Refuse a trajectory whose reading would delay a control loop.

    Raises:
        MessageError: More than `MOST_POINTS` points.
    """
    if points > MOST_POINTS:
        raise MessageError(
            f"{points} points, accepted: {MOST_POINTS}, so that reading them does not hold the "
            "loop up; send it in parts, or with points further apart"
        )


def require_points(cdr: bytes) -> None:
    """Refuse a trajectory with too many points before it is read.

    Its bytes begin with stamp, frame_id, number of names, names, number of points.

    Args:
        cdr: JointTrajectory with its encapsulation.

    Raises:
        MessageError: More than `MOST_POINTS` points, 4000 names, or bytes that end before their
            numbers.
    """
    order = "<" if cdr[1:2] == b"\x01" else ">"
    count = struct.Struct(f"{order}I")
    try:
        at = after_text(cdr, ENCAPSULATION + STAMP.size, count)
        (names,) = count.unpack_from(cdr, at)
        at += count.size
        if names > _MOST_NAMES:
            raise MessageError(f"{names} joint names, accepted: {_MOST_NAMES}")
        for _ in range(names):
            at = after_text(cdr, at, count)
        (points,) = count.unpack_from(cdr, at)
    except struct.error as error:
        raise MessageError("its bytes are no JointTrajectory") from error
    require_few(points)


def read_joint_motion(msg: Any) -> JointMotion:
    """Arrays of one message.

    Raises:
        MessageError: Not one point, or an array that is not as long as the names.
    """
    if len(msg.points) != 1:
        raise MessageError(f"{len(msg.points)} points, expected 1")
    names, arrays = tuple(msg.joint_names), []
    for field in _FIELDS:
        values = np.array(getattr(msg.points[0], field), dtype=np.float64)
        if len(values) != len(names):
            raise MessageError(f"{field} has {len(values)} values for {len(names)} names")
        arrays.append(values)
    return JointMotion(read_time(msg.header.stamp), names, *arrays)


class JointMotion(NamedTuple):
    """One state of joints with accelerations, which JointState has no field for.

    Attributes:
        stamp: Header stamp [ns].
        names: Joints, in the order of the arrays.
        position: [rad or m], shape (n,).
        velocity: [rad/s or m/s], shape (n,).
        acceleration: [rad/s^2 or m/s^2], shape (n,).
        effort: [N·m or N], shape (n,).
    """

    stamp: int
    names: tuple[str, ...]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    effort: NDArray[np.float64]


class JointMotionWriter:
    """Refills one kept message of one point.

    Args:
        msg: A fresh JointTrajectory.
        point: A fresh JointTrajectoryPoint; both belong to the writer from now on.
        names: Joints, in the order of the arrays.
    """

    def __init__(self, msg: Any, point: Any, names: Sequence[str]) -> None:
        self.msg, self._views = msg, []
        msg.joint_names = list(names)
        for field in _FIELDS:
            setattr(point, field, array("d", bytes(8 * len(names))))
            self._views.append(np.frombuffer(getattr(point, field), dtype=np.float64))
        msg.points = [point]

    def write(
        self,
        stamp: int,
        position: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
        effort: NDArray[np.float64],
    ) -> Any:
        """The kept message with new contents; arguments as the attributes of `JointMotion`.

        Raises:
            MessageError: A value is NaN or infinite, or no message can carry the stamp.
        """
        given = position, velocity, acceleration, effort
        require_finite(**dict(zip(_FIELDS, given, strict=True)))
        write_time(self.msg.header.stamp, stamp)
        for view, values in zip(self._views, given, strict=True):
            view[:] = values
        return self.msg
