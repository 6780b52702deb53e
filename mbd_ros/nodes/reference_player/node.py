"""Node `reference_player`: leads a controller along a trajectory, once it listens and answers."""

from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_reader import raw_messages, topic_types
from mbd_ros.methods.control.contract import ControlledJoints
from mbd_ros.nodes.shell.parameters import ALLOW_CODE, Parameter, ParameterError
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import permitting
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_trajectory import MOST_POINTS
from msg_adapters.time import NANOSECONDS

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
LOOK = 0.1  # s
_RATE = 20.0  # points a second
_LONGEST = 0.95 * MOST_POINTS / _RATE  # s
_REACH = 0.3  # share of the room to the position limits
_SPEED = 0.3  # share of the velocity limits


class ReferencePlayer(Shell):
    """Sends a JointTrajectory when the controller can hear it, and again when it is over.

    The trajectory comes from a bag, or moves each controlled joint of a scene about its initial
    position. It begins when it is sent: its stamp is 0. A message that is published before DDS
    has matched both ends is lost. So the node waits for a listener, and for the first state of the
    controller, which shows that it answers.
    """

    NAME = "reference_player"
    PARAMETERS = (
        Parameter("scene", str, "Scene whose controlled joints move; not used with a bag.", ""),
        ALLOW_CODE,
        Parameter("bag", str, "Bag with a JointTrajectory to send; empty: from the scene.", ""),
        Parameter("duration", float, "Of a trajectory from the scene [s].", 10.0, 1.0, _LONGEST),
        Parameter("repeat", bool, "Send it again when it is over.", True, read_only=False),
    )

    def configure_core(self) -> None:
        """Make the trajectory and its topics."""
        values = self.parameters
        if not (values.bag or values.scene):
            raise ParameterError("parameter 'scene' must be given, or 'bag'")
        if values.bag:
            self._trajectory = _recorded(values.bag)
        else:
            with permitting(values.allow_code):
                joints, start = _controlled(values.scene)
            self._trajectory = _swinging(joints, start, values.duration)
        last = self._trajectory.points[-1].time_from_start
        self._length = last.sec * NANOSECONDS + last.nanosec
        self._publisher = self.publish_to(JointTrajectory, "joint_trajectory", 1)
        self.subscribe(JointState, "state", self._on_state, 10, raw=True)
        self.every(LOOK, self._look)

    def activate_core(self) -> None:
        """Begin with the trajectory."""
        self._is_answered = False
        self._sent = 0
        self._next: int | None = None

    def reset(self, reason: str) -> None:
        """Time began anew, and so does the trajectory."""
        self.activate_core()

    def health(self) -> tuple[int, str, dict[str, str]]:
        """Whether somebody follows."""
        details = {"trajectories sent": str(self._sent) if self.active else "0"}
        if not self.active:
            return OK, "", details
        if self._sent:
            return OK, "leading", details
        lacking = "joint_trajectory" if self._is_answered else "state"
        topic = self.resolve_topic_name(lacking)
        return WARN, f"waiting for the controller on {topic}", details

    def _on_state(self, cdr: bytes) -> None:
        self._is_answered = True

    def _look(self) -> None:
        now = self.get_clock().now().nanoseconds
        is_due = self._next is None or (self.parameters.repeat and now >= self._next)
        if is_due and self._is_answered and self._publisher.get_subscription_count():
            self._publisher.publish(self._trajectory)
            self._publisher.wait_for_all_acked(Duration(seconds=1.0))
            self._next, self._sent = now + self._length, self._sent + 1
            self.get_logger().info(f"trajectory of {self._length / NANOSECONDS:.3g} s sent")


def _recorded(bag: str) -> Any:
    """The first trajectory of a bag, to begin on arrival."""
    topics = {name: kind for name, kind in topic_types(bag).items() if kind == TRAJECTORY}
    if not topics:
        raise DataError(f"{bag}: no topic of type {TRAJECTORY}")
    message = next(raw_messages(bag, topics))
    try:
        trajectory = deserialize_message(message.cdr, JointTrajectory)
    except rclpy_implementation.RMWError as error:
        raise DataError(f"{bag}: topic {message.topic}: unreadable message") from error
    if not trajectory.points:
        raise DataError(f"{bag}: topic {message.topic}: a trajectory without points")
    trajectory.header.stamp.sec = trajectory.header.stamp.nanosec = 0
    return trajectory


def _controlled(scene: str) -> tuple[ControlledJoints, Any]:
    """The controlled joints of a scene, and where they begin."""
    built = load_scene(scene)
    joints = built.controlled_joints()
    return joints, joints.positions(built.initial)


def _swinging(joints: ControlledJoints, start: Any, duration: float) -> Any:
    """There and back: q = start + A sin²(pi n t / T), with whole n, at rest at both ends.

    A is a share of the larger room to a limit, n the largest number that keeps a share of the
    velocity limit (A pi n / T).
    """
    lower = np.array([max(joint.lower, -np.pi) for joint in joints.joints])
    upper = np.array([min(joint.upper, np.pi) for joint in joints.joints])
    speed = np.array([min(joint.max_velocity, 1.0 / _SPEED) for joint in joints.joints])
    up, down = np.maximum(upper - start, 0.0), np.maximum(start - lower, 0.0)
    reach = _REACH * np.where(up >= down, up, -down)
    most = _SPEED * speed * duration / (np.pi * np.maximum(np.abs(reach), 1e-9))
    turns = np.clip(np.floor(most), 0.0, np.arange(len(start)) % 3 + 2.0)
    w = 2.0 * np.pi * turns / duration
    trajectory = JointTrajectory(joint_names=list(joints.names))
    for t in np.linspace(0.0, duration, round(duration * _RATE) + 1):
        point = JointTrajectoryPoint(
            positions=(start + 0.5 * reach * (1.0 - np.cos(w * t))).tolist(),
            velocities=(0.5 * reach * w * np.sin(w * t)).tolist(),
            accelerations=(0.5 * reach * w**2 * np.cos(w * t)).tolist(),
        )
        since = round(t * NANOSECONDS)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(since, NANOSECONDS)
        trajectory.points.append(point)
    return trajectory
