"""Serialized JointState -> message."""

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from msg_adapters.errors import MessageError


def joint_state(cdr: bytes) -> Any:
    """The message of these bytes.

    Raises:
        MessageError: They are none.
    """
    try:
        return deserialize_message(cdr, JointState)
    except rclpy_implementation.RMWError as error:
        raise MessageError("its bytes are no JointState") from error
