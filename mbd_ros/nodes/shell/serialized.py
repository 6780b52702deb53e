"""Serialized messages as the transport delivers them.

Nodes take bytes of every type. rclpy itself drops bytes that it cannot deserialize without a
trace, and turns messages that are too large into objects first.
"""

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from mbd_ros.scene.built_scene import MeasuredWrench
from msg_adapters.errors import MessageError
from msg_adapters.joint_trajectory import require_points
from msg_adapters.wrench import WrenchSample, read_wrench

LARGEST = 262_144  # bytes: 4000 joints
_LARGER = {String: 2**26, JointTrajectory: 2**24}  # bytes; a scene says itself what is too long


def message_of(cdr: bytes, kind: type) -> Any:
    """The message of these bytes.

    Raises:
        MessageError: They are none, or too many.
    """
    require_size(cdr, kind)
    try:
        return deserialize_message(cdr, kind)
    except rclpy_implementation.RMWError as error:
        raise MessageError(f"its bytes are no {kind.__name__}") from error


def require_size(cdr: bytes, kind: type) -> None:
    """Refuse a message that would hold the node up, before any work is done.

    Raises:
        MessageError: Names size, or points of a trajectory, and limit.
    """
    largest = _LARGER.get(kind, LARGEST)
    if len(cdr) > largest:
        raise MessageError(f"{len(cdr)} bytes, accepted: {largest} of a {kind.__name__}")
    if kind is JointTrajectory:
        require_points(cdr)


def joint_state(cdr: bytes) -> Any:
    """The JointState of these bytes; MessageError as `message_of`."""
    return message_of(cdr, JointState)


def read_load(msg: Any, wrench: MeasuredWrench) -> WrenchSample:
    """The sample of a WrenchStamped of an external load.

    Raises:
        MessageError: It names the load: a frame other than that of the scene, or a component that
            is NaN or infinite.
    """
    expected = wrench.expressed_in
    try:
        sample = read_wrench(msg)
    except MessageError as error:
        raise MessageError(f"wrench '{wrench.name}': {error}") from error
    if sample.frame_id not in ("", expected):
        raise MessageError(
            f"wrench '{wrench.name}': frame '{sample.frame_id}', expected '{expected}'"
        )
    return sample
