"""geometry_msgs/WrenchStamped <-> array of force then torque."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.time import read_time, write_time


class WrenchSample(NamedTuple):
    """One WrenchStamped.

    Attributes:
        stamp: Header stamp [ns].
        frame_id: Frame in which, and about whose origin, the wrench is given.
        wrench: Force [N] then torque [N·m], shape (6,).
    """

    stamp: int
    frame_id: str
    wrench: NDArray[np.float64]


def read_wrench(msg: Any) -> WrenchSample:
    """Array of one message.

    Raises:
        MessageError: A component is NaN or infinite.
    """
    force, torque = msg.wrench.force, msg.wrench.torque
    wrench = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z], dtype=np.float64)
    if not np.isfinite(wrench).all():
        raise MessageError(f"wrench is not finite: {wrench.tolist()}")
    return WrenchSample(read_time(msg.header.stamp), msg.header.frame_id, wrench)


def write_wrench(msg: Any, stamp: int, frame_id: str, wrench: NDArray[np.float64]) -> Any:
    """Fill a WrenchStamped and return it."""
    write_time(msg.header.stamp, stamp)
    msg.header.frame_id = frame_id
    force, torque = msg.wrench.force, msg.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench.tolist()
    return msg
