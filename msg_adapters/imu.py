"""sensor_msgs/Imu <-> angular velocity and linear acceleration."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.time import read_time, write_time

_UNKNOWN = -1.0  # first entry of a covariance, by which a message says that it has no such data


class ImuSample(NamedTuple):
    """One Imu.

    Attributes:
        stamp: Header stamp [ns]; 0 where the publisher set none.
        frame_id: In whose axes it measures.
        values: Angular velocity [rad/s], then linear acceleration [m/s^2], NaN where the message
            says that there is none, shape (6,).
    """

    stamp: int
    frame_id: str
    values: NDArray[np.float64]


def read_imu(msg: Any) -> ImuSample:
    """Arrays of one message.

    Raises:
        MessageError: A component is NaN or infinite, or a bad stamp.
    """
    turn, push = msg.angular_velocity, msg.linear_acceleration
    values = np.array([turn.x, turn.y, turn.z, push.x, push.y, push.z], dtype=np.float64)
    if not np.isfinite(values).all():
        raise MessageError(f"imu is not finite: {values.tolist()}")
    if msg.angular_velocity_covariance[0] == _UNKNOWN:
        values[:3] = np.nan
    if msg.linear_acceleration_covariance[0] == _UNKNOWN:
        values[3:] = np.nan
    return ImuSample(read_time(msg.header.stamp), msg.header.frame_id, values)


def write_imu(
    msg: Any,
    stamp: int,
    frame_id: str,
    values: NDArray[np.float64],
    noise: tuple[float, float],
) -> Any:
    """Fill an Imu without orientation and return it.

    Args:
        stamp: Header stamp [ns].
        frame_id: In whose axes it measures.
        values: Angular velocity [rad/s], then linear acceleration [m/s^2], shape (6,).
        noise: Their standard deviations.
    """
    write_time(msg.header.stamp, stamp)
    msg.header.frame_id = frame_id
    turn, push = msg.angular_velocity, msg.linear_acceleration
    turn.x, turn.y, turn.z, push.x, push.y, push.z = values.tolist()
    msg.orientation_covariance[0] = _UNKNOWN
    for covariance, deviation in (
        (msg.angular_velocity_covariance, noise[0]),
        (msg.linear_acceleration_covariance, noise[1]),
    ):
        for i in (0, 4, 8):
            covariance[i] = deviation**2
    return msg
