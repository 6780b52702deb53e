"""Messages inside of bags: the types of ROS 2 Jazzy, as dataclasses of rosbags.

Definitions inside a bag are not used: rosbags would compile them to Python code.
"""

from array import array
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from mbd_ros.errors import DataError

JOINT_STATE, ODOMETRY = "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
WRENCH = "geometry_msgs/msg/WrenchStamped"
MULTI_ARRAY, STRING = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/String"
TYPES = get_typestore(Stores.ROS2_JAZZY)
ZEROS = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}
DTYPES = {"byte": "uint8", "char": "uint8"}


def _check_type(msgtype: str) -> None:
    """Raise DataError for a type that ROS 2 Jazzy does not have."""
    if msgtype not in TYPES.fielddefs:
        raise DataError(f"{msgtype}: not a message type of ROS 2 Jazzy")


@cache
def type_hash(msgtype: str) -> str:
    """Hash by which rosbag2 and DDS tell definitions of one name apart."""
    return TYPES.hash_rihs01(msgtype)


def new_message(msgtype: str) -> Any:
    """A message to fill and write: zeros, empty texts and sequences, fixed arrays of zeros.

    Raises:
        DataError: A type that ROS 2 Jazzy does not have.
    """
    _check_type(msgtype)
    _, fields = TYPES.fielddefs[msgtype]
    return TYPES.types[msgtype](**{name: _initial(*field) for name, field in fields})


def _initial(kind: Nodetype, detail: Any) -> Any:
    if kind == Nodetype.NAME:
        return new_message(detail)
    if kind == Nodetype.BASE:
        return ZEROS.get(detail[0], 0)
    (inner, inner_detail), length = detail
    length = length if kind == Nodetype.ARRAY else 0  # of a sequence it is the upper bound
    if inner == Nodetype.BASE and inner_detail[0] != "string":
        return np.zeros(length, DTYPES.get(inner_detail[0], inner_detail[0]))
    return [_initial(inner, inner_detail) for _ in range(length)]


def to_cdr(message: Any, msgtype: str) -> memoryview:
    """Serialise; array.array fields, as `msg_adapters` leave them, are accepted."""
    arrays = {
        name: np.frombuffer(value, value.typecode)
        for name, value in vars(message).items()
        if isinstance(value, array)
    }
    return TYPES.serialize_cdr(replace(message, **arrays), msgtype)


def from_cdr(cdr: bytes, msgtype: str) -> Any:
    """Message of its CDR bytes."""
    _check_type(msgtype)
    return TYPES.deserialize_cdr(cdr, msgtype)
