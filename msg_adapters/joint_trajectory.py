"""trajectory_msgs/JointTrajectory -> arrays."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.time import NANOSECONDS, read_time

MOST_POINTS = 3000


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


def _table(points: Sequence[Any], field: str, size: int) -> NDArray[np.float64] | None:
    lengths = {len(getattr(point, field)) for point in points}
    if lengths == {0}:
        return None
    if lengths != {size}:
        raise MessageError(f"{field} of {sorted(lengths)} values for {size} joint names")
    return np.array([list(getattr(point, field)) for point in points], dtype=np.float64)
