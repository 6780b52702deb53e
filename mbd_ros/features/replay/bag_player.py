"""Plays messages to the node `inverse_dynamics` and records the answers."""

import subprocess
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from mbd_ros.errors import MbdError
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.jobs.progress import progress
from msg_adapters.diagnostics import read_diagnostics
from msg_adapters.joint_state import write_joint_state
from msg_adapters.time import read_time, write_time

NODE = "/inverse_dynamics"
TORQUES, CONSTRAINT_FORCES = f"{NODE}/joint_torques", f"{NODE}/constraint_forces"
JOINT_STATE, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
CLASSES = {JOINT_STATE: JointState, WRENCH: WrenchStamped, ODOMETRY: Odometry}
_START_TIMEOUT = 30.0  # [s] until the node must be active
_ANSWER_TIMEOUT = 2.0  # [s] without an answer, after which joint states count as lost
_IN_FLIGHT = 100  # joint states; the node's queue is deeper
_PATIENCE = 0.05  # [s] that a signal waits at most: an executor does not wake up for one
_CLOCK_PERIOD = 10_000_000  # ns of the bag
_DEEP = QoSProfile(depth=1000)  # nothing is lost in queues


class BagPlayer:
    """Publishes the messages of a bag in their rhythm and records the answers.

    Args:
        topics: Topics to publish, each with its type.
        answers: Topics that the node answers every joint state on.
        bag: Where the answers go.
        process: The node.

    Attributes:
        played: Joint states published.
    """

    def __init__(
        self,
        topics: dict[str, str],
        answers: Sequence[str],
        bag: BagWriter,
        process: "subprocess.Popen[bytes]",
    ) -> None:
        self.played = self._lost = 0
        self._answers, self._bag, self._process = dict.fromkeys(answers, 0), bag, process
        self._state = self._health = ""
        node = rclpy.create_node("mbd_ros_replay")
        self._publishers = {
            topic: node.create_publisher(CLASSES[kind], topic, _DEEP)
            for topic, kind in topics.items()
        }
        self._clock = node.create_publisher(Clock, "/clock", 1)
        self._clock_time = 0
        self._subscriptions = [
            node.create_subscription(JointState, topic, self._recorder(topic), _DEEP)
            for topic in answers
        ]
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        self._executor = EventsExecutor()
        self._executor.add_node(node)

    @property
    def answered(self) -> int:
        """Joint states that were answered on every topic."""
        return min(self._answers.values())

    def wait_for_node(self) -> None:
        """Until the node is active, hears every topic and is heard.

        Raises:
            ReplayError: It does not start, which names the reason, or is not alone.
        """
        deadline = time.monotonic() + _START_TIMEOUT
        while True:
            self._spin(_PATIENCE)
            self._check_alone()
            heard = all(p.get_subscription_count() for p in self._publishers.values())
            hears = all(s.get_publisher_count() for s in self._subscriptions)
            if self._state == "active" and heard and hears:
                return
            if self._state == "unconfigured" or self._process.poll() is not None:
                raise ReplayError(f"the node did not start: {self._health or 'it ended'}")
            if time.monotonic() > deadline:
                raise ReplayError(f"the node did not start within {_START_TIMEOUT:g} s")

    def play(self, messages: Sequence[tuple[str, int, Any]], topic: str, rate: float) -> None:
        """Publish everything, then wait for the last answers.

        Args:
            messages: Topic, log time [ns] and message.
            topic: The joint states among them.
            rate: Speed factor; 0 plays as fast as the node answers.

        Raises:
            ReplayError: The node ends, stops working, answers nothing, or is not alone.
        """
        begin, first = time.monotonic(), messages[0][1]
        for name, log_time, message in progress(messages, len(messages), "replaying"):
            self._check_node()
            if rate > 0:
                self._until(begin + (log_time - first) * 1e-9 / rate)
            self._publish_clock(log_time)
            stamp = message.header.stamp
            if stamp.sec == stamp.nanosec == 0:
                write_time(stamp, log_time)
            self._publishers[name].publish(message)
            self.played += name == topic
            self._wait_for_answers(_IN_FLIGHT)
        self._wait_for_answers(0)

    def _check_alone(self) -> None:
        for subscription in self._subscriptions:
            if subscription.get_publisher_count() > 1:
                topic = subscription.topic_name
                raise ReplayError(f"{topic}: another program publishes it on the same DDS domain")

    def _check_node(self) -> None:
        self._check_alone()
        code = self._process.poll()
        if code is not None or self._state != "active":
            what = f"is {self._state}" if code is None else f"ended with exit code {code}"
            raise ReplayError(f"the node {what}: {self._health}")

    def _publish_clock(self, log_time: int) -> None:
        if log_time - self._clock_time >= _CLOCK_PERIOD or log_time < self._clock_time:
            self._clock_time = log_time
            message = Clock()
            write_time(message.clock, log_time)
            self._clock.publish(message)

    def _wait_for_answers(self, in_flight: int) -> None:
        """Wait until at most `in_flight` joint states wait; one that waits too long is lost."""
        deadline, answered = time.monotonic() + _ANSWER_TIMEOUT, self.answered
        while self.played - self.answered - self._lost > in_flight:
            self._spin(_PATIENCE)
            if self.answered > answered:
                deadline, answered = time.monotonic() + _ANSWER_TIMEOUT, self.answered
            elif time.monotonic() > deadline:
                self._check_node()
                self._lost = self.played - self.answered
                if not self.answered:
                    raise ReplayError(
                        f"none of {self.played} joint states was answered: {self._health}"
                    )

    def _until(self, due: float) -> None:
        while (left := due - time.monotonic()) > 0:
            self._spin(min(left, _PATIENCE))

    def _spin(self, timeout: float) -> None:
        self._executor.spin_once(timeout_sec=timeout)

    def _recorder(self, topic: str) -> Any:
        def record(message: JointState) -> None:
            self._answers[topic] += 1
            stamp = read_time(message.header.stamp)
            fields = {name: getattr(message, name) for name in ("position", "velocity", "effort")}
            given = {name: values for name, values in fields.items() if values}
            copy = write_joint_state(new_message(JOINT_STATE), stamp, message.name, **given)
            self._bag.write(topic, JOINT_STATE, stamp, copy)

        return record

    def _on_health(self, message: DiagnosticArray) -> None:
        for health in read_diagnostics(message):
            if health.name == NODE:
                self._state, self._health = health.values.get("state", ""), health.message


class ReplayError(MbdError):
    """The replay cannot be what was asked for, or the node failed."""
