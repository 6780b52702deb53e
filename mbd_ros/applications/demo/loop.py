"""The closed loop of a demo over topics.

The simulator is in lock step: time stands, and each command advances it by one tick. The other
nodes live in the simulated time of /clock. On a machine under any load the physics is that of
a controller that answers every joint state before the next one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mbd_ros.applications.demo.files import GAINS, MODEL, PLANT, RATE
from mbd_ros.applications.demo.processes import Failed, NodeCommand, running
from mbd_ros.applications.demo.task import LAWS, ReferenceTrajectory
from mbd_ros.files.bags.bag_reader import RawMessage
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.jobs.isolated_domain import isolated_domain
from mbd_ros.jobs.progress import progress
from msg_adapters.diagnostics import Health, read_diagnostics
from msg_adapters.time import NANOSECONDS, read_time

SIMULATOR, WATCHER = "/simulator", "/inverse_dynamics"
STATES, CLOCK, DIAGNOSTICS = "/joint_states", "/clock", "/diagnostics"
FORCES, COMMANDS = f"{SIMULATOR}/constraint_forces", f"{SIMULATOR}/commands"
TORQUES, COUPLING = f"{WATCHER}/joint_torques", f"{WATCHER}/constraint_forces"
_JOINT_STATE = "sensor_msgs/msg/JointState"
# Records topics as they come, and calls services of nodes.
CLASSES = {
    "sensor_msgs/msg/JointState": JointState,
    "std_msgs/msg/Float64MultiArray": Float64MultiArray,
    "trajectory_msgs/msg/JointTrajectory": JointTrajectory,
    "diagnostic_msgs/msg/DiagnosticArray": DiagnosticArray,
    "rosgraph_msgs/msg/Clock": Clock,
}
_EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL)
_PATIENCE = 0.05  # s that a signal waits at most
_PERIOD = 0.01  # s between looks at what came; the readers keep it until then
_DEADLINE = 30.0  # s, of what takes a moment: a busy machine is no failure
_AGAIN = 1.0  # s until a request without an answer is sent again
CUTOFF = 20.0  # Hz, of the derivatives of the inverse dynamics
_STALL = 10.0  # s without a joint state
_DRAIN = 2.0  # s for the last answers


def record_loop(run: LoopRun, bag: Path) -> None:
    """Run the three nodes and record their messages.

    Raises:
        Failed: A node ends, refuses its part, or the loop stands still; or others publish here.
        DataError: The bag cannot be written.
    """
    recorded = recorded_topics(run.controller, run.has_rows, run.has_coupling)
    commands = _commands(run)
    with (
        BagWriter(bag) as writer,
        isolated_domain() as domain,
        running(commands, domain.environment, run.folder) as processes,
    ):

        def check() -> None:
            domain.check()  # first: Ctrl-C ends the nodes, too
            processes.check()

        recorder = Recorder(recorded, check, len(commands))
        try:
            _Lead(run, recorder).through()
        finally:
            recorder.close()
        recorder.write(writer)


def recorded_topics(controller: str, has_rows: bool, has_coupling: bool) -> dict[str, str]:
    """The recorded topics: name -> type.

    Args:
        controller: Fully qualified name of the node.
        has_rows: Whether the plant has constraint rows.
        has_coupling: Whether it has dependent joints.
    """
    optional = {FORCES: has_rows, COUPLING: has_coupling}
    return {
        STATES: _JOINT_STATE,
        COMMANDS: "std_msgs/msg/Float64MultiArray",
        loop_state(controller): _JOINT_STATE,
        reference(controller): "trajectory_msgs/msg/JointTrajectory",
        TORQUES: _JOINT_STATE,
        **{topic: _JOINT_STATE for topic, is_there in optional.items() if is_there},
        DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
        CLOCK: "rosgraph_msgs/msg/Clock",
    }


def loop_state(controller: str) -> str:
    """Topic of the tracking error of a controller."""
    return f"{controller}/state"


def reference(controller: str) -> str:
    """Topic of the reference of a controller."""
    return f"{controller}/joint_trajectory"


def _commands(run: LoopRun) -> list[NodeCommand]:
    timed = {"use_sim_time": "true"}
    plant = {"scene": str(run.folder / PLANT), "rate": f"{RATE:.1f}", "paused": "true"}
    return [
        NodeCommand("simulator", {**plant, "lock_step": "true", "publish_clock": "true"}),
        NodeCommand(
            LAWS[run.law],
            {**timed, "scene": str(run.folder / MODEL)},
            ("-r", f"~/commands:={COMMANDS}", "--params-file", str(run.folder / GAINS)),
        ),
        NodeCommand(
            "inverse_dynamics", {**timed, "scene": str(run.watched), "cutoff": f"{CUTOFF:.1f}"}
        ),
    ]


class _Lead:
    """Takes a recorded loop through its run."""

    def __init__(self, run: LoopRun, recorder: Recorder) -> None:
        self._run, self._recorder = run, recorder
        node = recorder.node
        self._reset = node.create_client(Trigger, f"{SIMULATOR}/reset")
        self._pause = node.create_client(SetBool, f"{SIMULATOR}/pause")
        topic = reference(run.controller)
        self._trajectory = node.create_publisher(JointTrajectory, topic, 1)

    def through(self) -> None:
        """From three nodes that start to the last answer."""
        recorder, run = self._recorder, self._run
        recorder.wait(self._is_ready, "start of the nodes")
        recorder.wait(self._is_answered, "answers to the first joint state")
        recorder.messages.clear()
        self._send_reference()
        recorder.ask(self._pause, SetBool.Request(data=False))  # the first state is shown again
        for _ in progress(self._ticks(), round(run.duration * 1000), "simulating"):
            pass
        recorder.ask(self._pause, SetBool.Request(data=True))
        self._drain()

    def _is_ready(self) -> bool:
        recorder, node = self._recorder, self._recorder.node
        nodes = (SIMULATOR, WATCHER, self._run.controller)
        states = {name: recorder.health[name] for name in nodes if name in recorder.health}
        for name, health in states.items():
            if health.values.get("state") == "unconfigured":
                raise Failed(f"node {name} did not start: {health.message}")
        return (
            len(states) == len(nodes)
            and all(health.values.get("state") == "active" for health in states.values())
            and recorder.is_complete()
            and node.count_subscribers(STATES) >= len(nodes)
            and node.count_subscribers(COMMANDS) >= 2
            and self._trajectory.get_subscription_count() >= 2
        )

    def _is_answered(self) -> bool:
        """Ask for the first joint state again, until all have heard it."""
        recorder = self._recorder
        recorder.ask(self._reset, Trigger.Request())
        recorder.spin(0.2)
        received = recorder.health[SIMULATOR].values["commands received"]
        return received != "0" and TORQUES in recorder.newest

    def _send_reference(self) -> None:
        """The reference, whose time 0 is that of the standing clock."""
        recorder, name = self._recorder, self._run.controller
        self._trajectory.publish(_message(self._run.joints, self._run.trajectory))
        self._trajectory.wait_for_all_acked(Duration(seconds=_STALL))

        def is_taken() -> bool:
            values: Mapping[str, str] = recorder.health[name].values
            if "dropped.reference" in values:
                raise Failed(f"node {name} refuses the reference")
            return values["reference"] == "trajectory"

        recorder.wait(is_taken, "the reference to be taken")

    def _ticks(self) -> Iterator[int]:
        """One item a simulated millisecond, as time passes."""
        recorder, shown, seen, since = self._recorder, 0, -1, time.monotonic()
        while (now := self._stamp(STATES)) < self._run.duration * NANOSECONDS:
            if now != seen:
                seen, since = now, time.monotonic()
            elif time.monotonic() - since > _STALL:
                raise Failed(f"the loop stands still at t = {now / NANOSECONDS:.3f} s")
            recorder.check()
            recorder.spin()
            yield from range(shown, shown := now // 1_000_000)

    def _drain(self) -> None:
        """Until the last joint state is answered, and the health after it is known."""
        recorder, end = self._recorder, time.monotonic() + _DRAIN
        while self._stamp(TORQUES) < self._stamp(STATES) and time.monotonic() < end:
            recorder.spin()
        last = recorder.health[SIMULATOR]
        recorder.wait(lambda: recorder.health[SIMULATOR] is not last, "diagnostics")

    def _stamp(self, topic: str) -> int:
        return read_time(self._recorder.read(topic).header.stamp)


def _message(joints: tuple[str, ...], trajectory: ReferenceTrajectory) -> JointTrajectory:
    message = JointTrajectory(joint_names=list(joints))
    for t, q, v, a in zip(*trajectory, strict=True):
        point = JointTrajectoryPoint(
            positions=q.tolist(), velocities=v.tolist(), accelerations=a.tolist()
        )
        since = round(t * NANOSECONDS)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(since, NANOSECONDS)
        message.points.append(point)
    return message


class LoopRun(NamedTuple):
    """Order of a run.

    Attributes:
        folder: With the scenes and the gains.
        watched: Scene of the inverse dynamics: the true robot, without the disturbance.
        law: A key of `LAWS`.
        duration: [s].
        has_rows: Whether the plant has constraint rows.
        has_coupling: Whether it has dependent joints.
    """

    folder: Path
    watched: Path
    law: str
    joints: tuple[str, ...]
    trajectory: ReferenceTrajectory
    duration: float
    has_rows: bool
    has_coupling: bool

    @property
    def controller(self) -> str:
        """Fully qualified name of the controller."""
        return f"/{LAWS[self.law]}"


class Recorder:
    """Keeps the serialized messages of topics with the time at which they were published.

    Messages are taken from their readers in turns: their times are those of the publisher, and
    no callback delays another one.

    Args:
        topics: Name -> type; DIAGNOSTICS must be among them.
        check: Raises if waiting has become useless; called often, but not within rclpy.
        nodes: How many nodes are recorded: each publishes DIAGNOSTICS, and one any other topic.

    Attributes:
        node: For publishers and clients of the code that leads the recording.
        messages: All messages; log times are those of publishing.
        newest: Topic -> its newest message, serialized; of topics that something came on.
        health: Node -> its newest status.
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
        self._executor.shutdown()
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
