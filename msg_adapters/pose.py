"""nav_msgs/Odometry and geometry_msgs/PoseStamped <-> poses and twists.

A pose is a place, then a quaternion (x, y, z, w). Source: REP 103 and the definition of
nav_msgs/Odometry: the pose is in frame_id, the twist in child_frame_id; layout as `cdr`.
"""

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.cdr import HEAD, STAMP, encoded_text, refilled
from msg_adapters.errors import MessageError, is_surely_finite, listed, require_finite
from msg_adapters.time import read_time, seconds_of, write_time

_DOUBLES = struct.Struct("<7d288x6d288x")
_TWIST = 7 * 8 + 288  # its place behind that of the pose
OFF_UNIT = 0.1  # by which a quaternion may miss its length of 1


class OdometrySample(NamedTuple):
    """One Odometry.

    Attributes:
        stamp: Header stamp [ns]; 0 where the publisher set none.
        frame_id: Frame of the pose.
        child_frame_id: Frame of the twist: a link of the body.
        pose: Place [m], then quaternion (x, y, z, w), shape (7,).
        twist: Velocity [m/s], then angular velocity [rad/s], shape (6,); NaN where a component
            is not finite.
    """

    stamp: int
    frame_id: str
    child_frame_id: str
    pose: NDArray[np.float64]
    twist: NDArray[np.float64]


def read_odometry(msg: Any, link: str = "") -> OdometrySample:
    """Arrays of one message; covariances are not read.

    Args:
        msg: Odometry of rclpy, rosbags, or anything with the same fields.
        link: Its `child_frame_id` must be this one, with or without the name of the robot in
            front, or empty; any without it.

    Raises:
        MessageError: Another link, a pose that is not finite, a quaternion far from length 1, or a
            stamp that no message can carry back.
    """
    child = msg.child_frame_id
    if link and child not in ("", link, link.rpartition("/")[2]):
        raise MessageError(f"child_frame_id is {listed([child])}, expected {link}")
    pose = _pose_of(msg.pose.pose)
    linear, angular = msg.twist.twist.linear, msg.twist.twist.angular
    twist = np.array(
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z], dtype=np.float64
    )
    twist[~np.isfinite(twist)] = np.nan
    frames = msg.header.frame_id, child
    return OdometrySample(read_time(msg.header.stamp), *frames, pose, twist)


class OdometryCdrWriter:
    """Writes serialized messages of one body, whose covariances are 0.

    Layout after the encapsulation, little endian: sec, nanosec, frame_id, child_frame_id; then,
    aligned to 8, the doubles: place, quaternion (x, y, z, w), 36 of a covariance, velocity,
    angular velocity, 36 of a covariance.

    Args:
        frame_id: Frame of the pose.
        child_frame_id: Frame of the twist.
    """

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        texts = encoded_text(frame_id) + encoded_text(child_frame_id)
        self._texts = texts + bytes(-(STAMP.size + len(texts)) % 8)

    def write(self, stamp: int, pose: NDArray[np.float64], twist: NDArray[np.float64]) -> bytes:
        """A message; arguments as the attributes of `OdometrySample`.

        Raises:
            MessageError: A value is NaN or infinite, or no message can carry the stamp.
        """
        require_finite(pose=pose, twist=twist)
        numbers = _DOUBLES.pack(*pose.tolist(), *twist.tolist())
        return HEAD + STAMP.pack(*seconds_of(stamp)) + self._texts + numbers

    def rows(
        self, stamps: NDArray[np.int64], pose: NDArray[np.float64], twist: NDArray[np.float64]
    ) -> NDArray[np.uint8]:
        """Many messages, one a row; arguments as those of `write`, one row each."""
        for values in (pose, twist):
            if not is_surely_finite(values):
                lost = np.flatnonzero(~np.isfinite(pose).all(axis=1) | ~np.isfinite(twist).all(1))
                for row in lost[:1]:
                    require_finite(pose=pose[row], twist=twist[row])
        template = self.write(0, np.zeros(7), np.zeros(6))
        begin = len(template) - _DOUBLES.size
        return refilled(template, {begin: pose, begin + _TWIST: twist}, stamps)


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
    pose = _pose_of(msg.pose)
    return PoseSample(read_time(msg.header.stamp), msg.header.frame_id, pose)


def write_pose(msg: Any, stamp: int, frame_id: str, pose: NDArray[np.float64]) -> Any:
    """Fill a PoseStamped and return it.

    Args:
        stamp: Header stamp [ns].
        frame_id: Frame in which the pose is given.
        pose: Place [m], then quaternion (x, y, z, w), shape (7,).
    """
    write_time(msg.header.stamp, stamp)
    msg.header.frame_id = frame_id
    at, turn = msg.pose.position, msg.pose.orientation
    at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w = pose.tolist()
    return msg


def _pose_of(pose: Any) -> NDArray[np.float64]:
    """A geometry_msgs/Pose that is finite, its quaternion of length 1."""
    at, turn = pose.position, pose.orientation
    values = np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w], dtype=np.float64)
    if not np.isfinite(values).all():
        raise MessageError(f"pose is not finite: {values.tolist()}")
    length = float(np.linalg.norm(values[3:]))
    if not abs(length - 1.0) <= OFF_UNIT:
        raise MessageError(f"orientation has the length {length:.3g}, a quaternion has 1")
    return values
