"""control_msgs/action/FollowJointTrajectory <-> arrays."""

from array import array
from typing import Any, NamedTuple

from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.joint_trajectory import Trajectory, read_joint_trajectory
from msg_adapters.time import NANOSECONDS, write_time

_UNUSED = ("component_path_tolerance", "component_goal_tolerance")


class GoalRequest(NamedTuple):
    """The request of a client; tolerances are (name, position, velocity, acceleration).

    Attributes:
        trajectory: Without points: stop.
        path: Tolerances on the way.
        goal: Tolerances at the end.
        time: Tolerance of the time at the end [s].
    """

    trajectory: Trajectory
    path: tuple[tuple[str, float, float, float], ...]
    goal: tuple[tuple[str, float, float, float], ...]
    time: float


def read_goal(msg: Any) -> GoalRequest:
    """The goal of a request.

    Raises:
        MessageError: A malformed trajectory, or parts for joints of more than one coordinate.
    """
    multi = msg.multi_dof_trajectory
    given = [field for field in _UNUSED if getattr(msg, field)]
    given += ["multi_dof_trajectory"] if multi.points or multi.joint_names else []
    if given:
        raise MessageError(f"{given[0]}: joints have one coordinate, leave it empty")
    wait = msg.goal_time_tolerance
    return GoalRequest(
        read_joint_trajectory(msg.trajectory),
        tuple((t.name, t.position, t.velocity, t.acceleration) for t in msg.path_tolerance),
        tuple((t.name, t.position, t.velocity, t.acceleration) for t in msg.goal_tolerance),
        wait.sec + wait.nanosec / NANOSECONDS,
    )


class FeedbackWriter:
    """Refills one kept feedback message.

    Args:
        msg: A fresh Feedback; it belongs to the writer from now on.
        names: Joints, in the order of the arrays.
    """

    def __init__(self, msg: Any, names: tuple[str, ...]) -> None:
        self._msg = msg
        msg.joint_names = list(names)

    def write(
        self,
        stamp: int,
        elapsed: float,
        desired: tuple[NDArray[Any], NDArray[Any], NDArray[Any]],
        actual: tuple[NDArray[Any], NDArray[Any]],
    ) -> Any:
        """The kept message with new contents; error is desired - actual.

        Args:
            stamp: [ns].
            elapsed: Since the begin of the trajectory [s].
            desired: Positions, velocities and accelerations, shape (n,) each.
            actual: Positions and velocities, shape (n,) each.
        """
        msg, error = self._msg, tuple(d - a for d, a in zip(desired, actual, strict=False))
        write_time(msg.header.stamp, stamp)
        for point, values in ((msg.desired, desired), (msg.actual, actual), (msg.error, error)):
            write_time(point.time_from_start, max(round(elapsed * NANOSECONDS), 0))
            names = ("positions", "velocities", "accelerations")
            for name, numbers in zip(names, values, strict=False):
                setattr(point, name, array("d", numbers.tobytes()))
        return msg
