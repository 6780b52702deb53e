"""geometry_msgs/PoseStamped <-> array of place, then quaternion (x, y, z, w)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.odometry import OFF_UNIT
from msg_adapters.time import read_time, write_time


class PoseSample(NamedTuple):
    """One PoseStamped.

    Attributes:
        stamp: Header stamp [ns]; 0 where the publisher set none.
        frame_id: Frame in which the pose is given.
        pose: Place [m], then quaternion (x, y, z, w), shape (7,).
    """

    stamp: int
    frame_id: str
    pose: NDArray[np.float64]


def read_pose(msg: Any) -> PoseSample:
    """Array of one message.

    Raises:
        MessageError: A component is NaN or infinite, a quaternion is far from length 1, or a bad
            stamp.
    """
    at, turn = msg.pose.position, msg.pose.orientation
    pose = np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w], dtype=np.float64)
    if not np.isfinite(pose).all():
        raise MessageError(f"pose is not finite: {pose.tolist()}")
    length = float(np.linalg.norm(pose[3:]))
    if not abs(length - 1.0) <= OFF_UNIT:
        raise MessageError(f"orientation has the length {length:.3g}, a quaternion has 1")
    return PoseSample(read_time(msg.header.stamp), msg.header.frame_id, pose)


def write_pose(msg: Any, stamp: int, frame_id: str, pose: NDArray[np.float64]) -> Any:
    """Fill a PoseStamped and return it.

    Args:
        msg: To fill.
        stamp: Header stamp [ns].
        frame_id: Frame in which the pose is given.
        pose: Place [m], then quaternion (x, y, z, w), shape (7,).
    """
    write_time(msg.header.stamp, stamp)
    msg.header.frame_id = frame_id
    at, turn = msg.pose.position, msg.pose.orientation
    at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w = pose.tolist()
    return msg
