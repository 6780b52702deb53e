"""A bag through the live node, which runs as its own process: `mbd-ros replay`."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from mbd_ros.bags import BagWriter, new_message, raw_messages
from mbd_ros.errors import MbdError
from mbd_ros.progress import progress
from mbd_ros.scene import load_scene
from msg_adapters.diagnostics import read_diagnostics
from msg_adapters.joint_state import write_joint_state
from msg_adapters.time import read_time, write_time

NODE = "/inverse_dynamics"
TORQUES, CONSTRAINT_FORCES = f"{NODE}/joint_torques", f"{NODE}/constraint_forces"
JOINT_STATE = "sensor_msgs/msg/JointState"
_CLASSES = {JOINT_STATE: JointState, "geometry_msgs/msg/WrenchStamped": WrenchStamped}
_START_TIMEOUT, _ANSWER_TIMEOUT, _STOP_TIMEOUT = 30.0, 2.0, 10.0  # s
_CLOCK_PERIOD = 10_000_000  # ns of the bag
_WRENCH_WAIT = 1.0  # s: better a late answer than one without its wrench
_DEEP = QoSProfile(depth=1000)


class ReplayError(MbdError):
    """The node did not start, or ended before the bag did."""


@dataclass(frozen=True)
class Replay:
    """What to play and how.

    Attributes:
        bag: Recording to play.
        scene: Scene of the node.
        out: Bag of what the node answers.
        rate: Speed factor; 0 plays the next joint state as soon as the last one is answered.
        topic: JointState topic of the bag.
        cutoff: Half-power frequency of the node's derivative filters [Hz].
    """

    bag: Path
    scene: Path
    out: Path
    rate: float
    topic: str
    cutoff: float


def play(replay: Replay) -> tuple[int, int]:
    """Play a bag to the node and record what it answers.

    Both run on a DDS domain of their own, which never leaves this machine, under the time of the bag.

    Returns:
        Numbers of joint states played and answered.

    Raises:
        MbdError: The bag does not fit the scene, or the node does not start or fails.
    """
    topics = {replay.topic: JOINT_STATE}
    for name, wrench in load_scene(replay.scene).wrenches.items():
        topics[wrench.topic or f"{NODE}/wrench/{name}"] = "geometry_msgs/msg/WrenchStamped"
    messages = [
        (raw.topic, raw.log_time, deserialize_message(raw.cdr, _CLASSES[raw.msgtype]))
        for raw in raw_messages(replay.bag, topics)
    ]
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    os.environ.update(environment)
    domain = 1 + os.getpid() % 100
    rclpy.init(args=[], domain_id=domain)
    try:
        with BagWriter(replay.out) as bag:
            player = _Player(topics, replay, bag)
            with _node_process(replay, {**environment, "ROS_DOMAIN_ID": str(domain)}) as process:
                player.wait_for(process)
                player.play(messages, process)
            return player.played, player.answered
    finally:
        rclpy.try_shutdown()


class _Player:
    """Publishes the messages of a bag in their rhythm and records the answers."""

    def __init__(self, topics: dict[str, str], replay: Replay, bag: BagWriter) -> None:
        self.played = self.answered = 0
        self._replay, self._bag = replay, bag
        self._health: tuple[str, str] = ("", "")
        node = rclpy.create_node("mbd_ros_replay")
        self._publishers = {
            topic: node.create_publisher(_CLASSES[kind], topic, _DEEP)
            for topic, kind in topics.items()
        }
        self._clock = node.create_publisher(Clock, "/clock", 1)
        self._clock_time = 0
        node.create_subscription(JointState, TORQUES, self._on_torques, _DEEP)
        node.create_subscription(JointState, CONSTRAINT_FORCES, self._on_forces, _DEEP)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        self._executor = EventsExecutor()
        self._executor.add_node(node)

    def wait_for(self, process: "subprocess.Popen[bytes]") -> None:
        """Until the node is active and hears every topic."""
        deadline = time.monotonic() + _START_TIMEOUT
        while True:
            self._spin(0.05)
            state, text = self._health
            heard = all(p.get_subscription_count() for p in self._publishers.values())
            if state == "active" and heard:
                return
            if state == "unconfigured" or process.poll() is not None:
                raise ReplayError(f"the node did not start: {text or 'it ended'}")
            if time.monotonic() > deadline:
                raise ReplayError(f"the node did not start within {_START_TIMEOUT:g} s")

    def play(
        self, messages: list[tuple[str, int, Any]], process: "subprocess.Popen[bytes]"
    ) -> None:
        """Publish everything, then wait for the last answers."""
        begin, first = time.monotonic(), messages[0][1]
        for topic, log_time, message in progress(messages, len(messages), "replaying"):
            if process.poll() is not None:
                raise ReplayError(f"the node ended with exit code {process.returncode}")
            if self._replay.rate > 0:
                self._until(begin + (log_time - first) * 1e-9 / self._replay.rate)
            self._publish_clock(log_time)
            if read_time(message.header.stamp) == 0:
                write_time(message.header.stamp, log_time)
            self._publishers[topic].publish(message)
            if topic == self._replay.topic:
                self.played += 1
                if self._replay.rate == 0:
                    self._wait_for_answers()
        self._wait_for_answers()

    def _publish_clock(self, log_time: int) -> None:
        if log_time - self._clock_time >= _CLOCK_PERIOD or log_time < self._clock_time:
            self._clock_time = log_time
            message = Clock()
            write_time(message.clock, log_time)
            self._clock.publish(message)

    def _wait_for_answers(self) -> None:
        deadline, answered = time.monotonic() + _ANSWER_TIMEOUT, self.answered
        while self.answered < self.played and time.monotonic() < deadline:
            self._spin(0.05)
            if self.answered > answered:
                deadline, answered = time.monotonic() + _ANSWER_TIMEOUT, self.answered

    def _until(self, due: float) -> None:
        while (left := due - time.monotonic()) > 0:
            self._spin(left)

    def _spin(self, timeout: float) -> None:
        self._executor.spin_once(timeout_sec=timeout)

    def _on_torques(self, message: JointState) -> None:
        self.answered += 1
        self._record(TORQUES, message)

    def _on_forces(self, message: JointState) -> None:
        self._record(CONSTRAINT_FORCES, message)

    def _record(self, topic: str, message: JointState) -> None:
        stamp = read_time(message.header.stamp)
        fields = {field: getattr(message, field) for field in ("position", "velocity", "effort")}
        given = {field: values for field, values in fields.items() if values}
        copy = write_joint_state(new_message(JOINT_STATE), stamp, message.name, **given)
        self._bag.write(topic, JOINT_STATE, stamp, copy)

    def _on_health(self, message: DiagnosticArray) -> None:
        for health in read_diagnostics(message):
            if health.name == NODE:
                self._health = (health.values.get("state", ""), health.message)


@contextmanager
def _node_process(
    replay: Replay, environment: dict[str, str]
) -> Iterator["subprocess.Popen[bytes]"]:
    parameters = {
        "scene": str(replay.scene.resolve()),
        "use_sim_time": "true",
        "cutoff": str(replay.cutoff),
        "wrench_wait": str(_WRENCH_WAIT),
    }
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", "mbd_ros.nodes.inverse_dynamics", "--ros-args", *words]
    command += ["-r", f"joint_states:={replay.topic}"]
    process = subprocess.Popen(command, env=environment)
    try:
        yield process
        process.send_signal(signal.SIGINT)
        if process.wait(_STOP_TIMEOUT) != 0:
            raise ReplayError(f"the node ended with exit code {process.returncode}")
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
