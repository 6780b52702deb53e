"""Records topics as they come, and calls services of nodes."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.experimental import EventsExecutor
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from mbd_ros.applications.demo.processes import Failed
from mbd_ros.applications.demo.topics import DIAGNOSTICS
from mbd_ros.files.bags.bags import BagWriter, RawMessage
from msg_adapters.diagnostics import Health, read_diagnostics

CLASSES = {
    "sensor_msgs/msg/JointState": JointState,
    "std_msgs/msg/Float64MultiArray": Float64MultiArray,
    "trajectory_msgs/msg/JointTrajectory": JointTrajectory,
    "diagnostic_msgs/msg/DiagnosticArray": DiagnosticArray,
    "rosgraph_msgs/msg/Clock": Clock,
}
_EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL)
_PATIENCE = 0.05  # [s] that a signal waits at most: an executor does not wake up for one
_PERIOD = 0.01  # s between looks at what came; the readers keep it until then
_DEADLINE = 30.0  # s, of what takes a moment: a busy machine is no failure
_AGAIN = 1.0  # s until a request without an answer is sent again


class Recorder:
    """Keeps the serialized messages of topics with the time at which they were published.

    Messages are taken from their readers in turns: their times are those of the publisher, and
    no callback delays another one.

    Args:
        topics: Name -> type; DIAGNOSTICS must be among them.
        check: Raises if waiting has become useless; called often.
        nodes: How many nodes are recorded: each publishes DIAGNOSTICS, and one any other topic.

    Attributes:
        node: For publishers and clients of the code that leads the recording.
        messages: All messages; log times are those of publishing.
        newest: Topic -> its newest message, serialized; of topics that something came on.
        health: Node -> its newest status.
        check: As given.
    """

    def __init__(self, topics: Mapping[str, str], check: Callable[[], None], nodes: int) -> None:
        self.messages: list[RawMessage] = []
        self.newest: dict[str, bytes] = {}
        self.health: dict[str, Health] = {}
        self.check = check
        self.node = rclpy.create_node("mbd_ros_demo")
        self._reader = rclpy.create_node("mbd_ros_demo_recorder")  # of no executor
        self._types = dict(topics)
        self._publishers = {**dict.fromkeys(topics, 1), DIAGNOSTICS: nodes}
        self._subscriptions = {
            topic: self._reader.create_subscription(
                CLASSES[kind], topic, lambda _: None, _EVERYTHING, raw=True
            )
            for topic, kind in topics.items()
        }
        self._executor = EventsExecutor()
        self._executor.add_node(self.node)

    def is_complete(self) -> bool:
        """Whether every topic has a publisher."""
        return all(s.get_publisher_count() for s in self._subscriptions.values())

    def read(self, topic: str) -> Any:
        """The newest message of a topic."""
        return deserialize_message(self.newest[topic], CLASSES[self._types[topic]])

    def spin(self, seconds: float = _PATIENCE) -> None:
        """Take messages for so long [s].

        Raises:
            Failed: A topic is published by more than the recorded nodes.
        """
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, _PERIOD))
            for topic, subscription in self._subscriptions.items():
                self._take(topic, subscription.handle)
                if subscription.get_publisher_count() > self._publishers[topic]:
                    raise Failed(f"{topic}: another program publishes it on the same DDS domain")

    def wait(self, done: Callable[[], Any], what: str, timeout: float = _DEADLINE) -> None:
        """Take messages until `done()`.

        Raises:
            Failed: It is not within `timeout` [s]; `what` is missing then.
        """
        end = time.monotonic() + timeout
        while not done():
            self.check()
            if time.monotonic() > end:
                said = "; ".join(f"{name}: {h.message}" for name, h in self.health.items())
                raise Failed(f"{what}: not within {timeout:g} s ({said or 'no diagnostics'})")
            self.spin()

    def ask(self, client: Any, request: Any) -> None:
        """Send a request until it is answered.

        A client knows a service a moment before the service knows the client, and the response
        to an unknown client is lost.

        Args:
            client: Of the service.
            request: May be heard twice.

        Raises:
            Failed: It is refused, or never answered.
        """
        end, answer, again = time.monotonic() + _DEADLINE, None, 0.0
        while answer is None or not answer.done():
            now = time.monotonic()
            if now > end:
                raise Failed(f"{client.srv_name}: not answered within {_DEADLINE:g} s")
            if answer is None or now > again:
                answer, again = client.call_async(request), now + _AGAIN
            self.check()
            self.spin(0.01)
        if not answer.result().success:
            raise Failed(f"{client.srv_name}: {answer.result().message}")

    def write(self, bag: BagWriter) -> None:
        """Put everything that was kept into a bag."""
        for message in sorted(self.messages, key=lambda message: message.log_time):
            bag.write(message.topic, message.msgtype, message.log_time, message.cdr)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        self._reader.destroy_node()

    def _take(self, topic: str, reader: Any) -> None:
        """Everything that waits in a reader."""
        kind = self._types[topic]
        with reader:
            while (taken := reader.take_message(CLASSES[kind], True)) is not None:
                cdr, info = taken
                self.messages.append(RawMessage(topic, kind, info["source_timestamp"], cdr))
                self.newest[topic] = cdr
                if topic == DIAGNOSTICS:
                    statuses = read_diagnostics(deserialize_message(cdr, DiagnosticArray))
                    self.health.update({status.name: status for status in statuses})
