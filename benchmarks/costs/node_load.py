"""Cost of a node under a steady stream of joint states: CPU, round trip, losses."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from mbd_ros.jobs.isolated_domain import isolated_domain
from msg_adapters.joint_state import JointStateWriter
from msg_adapters.time import read_time

_STREAM = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)


class Load(NamedTuple):
    """Measured at one node in a process of its own.

    Attributes:
        sent: Joint states published.
        answered: Answers received.
        main_thread_us: CPU of the node's main thread per message [us].
        process_us: CPU of the whole process per message [us].
        round_trip_us: Median time from publishing to the answer [us].
        worst_us: Longest such time [us].
        late_us: Time that 1 % of the answers take longer than [us].
    """

    sent: int
    answered: int
    main_thread_us: float
    process_us: float
    round_trip_us: float
    worst_us: float
    late_us: float


def measure(
    arguments: Sequence[str],
    joints: Sequence[str],
    *,
    seconds: float,
    rate: float = 0.0,
    in_flight: int = 1,
    answers: str = "/inverse_dynamics/joint_torques",
) -> Load:
    """Start a node, send it joint states, count and time its answers.

    Args:
        arguments: Of the Python interpreter, such as `-m mbd_ros.nodes inverse_dynamics`.
        joints: Names in the messages.
        seconds: Duration of the stream.
        rate: Messages per second; 0 sends as fast as the node answers.
        in_flight: Messages on the way at a time, without a rate.
        answers: Topic of JointStates that answer.
    """
    with (
        isolated_domain() as environment,
        _running([sys.executable, *arguments], environment) as process,
    ):
        source = _Source(joints, answers)
        try:
            source.wait_for_answer(process)
            before = _cpu(process.pid)
            if rate > 0:
                source.stream(rate, seconds)
            else:
                source.saturate(in_flight, seconds)
            after = _cpu(process.pid)
            return source.load([b - a for a, b in zip(before, after, strict=True)])
        finally:
            source.close()


@contextmanager
def _running(
    command: Sequence[str], environment: Mapping[str, str]
) -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(command, env=environment)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(10.0)


class _Source:
    def __init__(self, joints: Sequence[str], topic: str) -> None:
        self._node = rclpy.create_node("mbd_ros_load")
        self._publisher = self._node.create_publisher(JointState, "joint_states", _STREAM)
        self._node.create_subscription(JointState, topic, self._on_answer, QoSProfile(depth=1000))
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._writer = JointStateWriter(JointState(), joints)
        self._phase = np.arange(len(joints)) * 0.7
        self._sent, self._trips = 0, [0.0]

    def wait_for_answer(self, process: "subprocess.Popen[bytes]") -> None:
        """Until the node answers, then until it is quiet again."""
        self._trips.clear()
        while not self._trips:
            if process.poll() is not None:
                raise RuntimeError(f"the node ended with exit code {process.returncode}")
            self._publish()
            self._spin_until(time.perf_counter() + 0.1)
        self._spin_until(time.perf_counter() + 1.0)

    def stream(self, rate: float, seconds: float) -> None:
        """Publish at a rate, taking answers in between."""
        self._sent = 0
        self._trips.clear()
        begin = time.perf_counter()
        for i in range(int(rate * seconds)):
            self._spin_until(begin + i / rate)
            self._publish()
        self._spin_until(time.perf_counter() + 0.5)

    def saturate(self, in_flight: int, seconds: float) -> None:
        """Publish whenever an answer comes, or is lost."""
        self._sent = 0
        self._trips.clear()
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            while self._sent - len(self._trips) < in_flight:
                self._publish()
            answered = len(self._trips)
            self._executor.spin_once(timeout_sec=0.2)
            if len(self._trips) == answered:
                break
        self._spin_until(time.perf_counter() + 0.5)

    def load(self, cpu: Sequence[float]) -> Load:
        """What was measured since `stream` began."""
        main_thread, process = (1e6 * seconds / self._sent for seconds in cpu)
        trips = np.array(self._trips) * 1e6
        return Load(
            self._sent,
            len(trips),
            round(main_thread, 1),
            round(process, 1),
            round(float(np.median(trips)), 1),
            round(float(trips.max()), 1),
            round(float(np.quantile(trips, 0.99)), 1),
        )

    def close(self) -> None:
        """Leave the graph."""
        self._executor.remove_node(self._node)
        self._node.destroy_node()

    def _publish(self) -> None:
        stamp = time.time_ns()
        t = self._phase + stamp % 10**12 * 1e-9
        message = self._writer.write(
            stamp, position=0.5 * np.sin(t), velocity=0.5 * np.cos(t), effort=0.0
        )
        self._publisher.publish(message)
        self._sent += 1

    def _on_answer(self, message: JointState) -> None:
        self._trips.append((time.time_ns() - read_time(message.header.stamp)) * 1e-9)

    def _spin_until(self, due: float) -> None:
        while (left := due - time.perf_counter()) > 0:
            self._executor.spin_once(timeout_sec=left)


def _cpu(pid: int) -> tuple[float, float]:
    """CPU time of the main thread and of the whole process [s]."""
    return _ticks(f"/proc/{pid}/task/{pid}/stat"), _ticks(f"/proc/{pid}/stat")


def _ticks(path: str) -> float:
    with open(path, encoding="ascii") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
