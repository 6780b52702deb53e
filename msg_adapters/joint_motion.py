"""State of joints with accelerations, as trajectory_msgs/JointTrajectory of one point.

JointState has no field for accelerations.
"""

from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.finite import require_finite
from msg_adapters.time import read_time, write_time

_FIELDS = ("positions", "velocities", "accelerations", "effort")


class JointMotion(NamedTuple):
    """One state of joints.

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


class JointMotionWriter:
    """Refills one kept message.

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
