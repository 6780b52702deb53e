"""Replay of a bag through the live node in a process of its own: `mbd-ros replay`.

The torques of the node are compared with a reference, joint by joint.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError, MbdError
from mbd_ros.files.bag_paths import beside, by_member, joint_state_topic, odometry_topic
from mbd_ros.files.bags.bag_reader import RawMessage, raw_messages
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.table import MAIN, Column, Result, Table, time_columns
from mbd_ros.jobs.isolated_domain import isolated_domain
from mbd_ros.jobs.progress import progress
from mbd_ros.motion.recordings import metadata_of, read_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import is_permitted
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
_IN_FLIGHT = 100  # joint states without an answer; the queue of the node is deeper
_SPIN_TIME = 0.05  # s, longest delay of a signal
_CLOCK_PERIOD = 10_000_000  # ns of the bag
_DEEP = QoSProfile(depth=1000)  # so that no message is lost
UNIT = "N·m or N"
_STOP_TIMEOUT = 10.0  # [s] until the node must have ended
_WRENCH_WAIT = 1.0  # s: better a late answer than one without its wrench
_CLOCK_TOLERANCE = 1e10  # s, since clocks of recorder and robot may differ


def replay(
    order: Replay,
    reference: str | None = None,
    skip: float = 0.5,
    *,
    say: Callable[[str], None],
) -> Result:
    """Play a bag to the node and compare its torques with those of a topic.

    Args:
        order: The bag, and how it is played.
        reference: JointState topic of the bag whose efforts are the reference. By default the
            topic that is played.
        skip: Time at the start that the errors leave out [s].
        say: Called with the counts of messages and the table of errors, line by line.

    Returns:
        The result of `compare`, with the metadata `played` and `answered`.
    """
    scene = load_scene(order.scene)
    played, answered = play(order)
    say(f"{played} joint states played, {answered} answered, {played - answered} lost")
    known = order.bag, reference or order.topic
    joints, members = scene.couplings.independent, scene.robot.members
    comparison = compare((order.out, TORQUES), known, joints, skip, say, members)
    inputs = {"bag": order.bag, "rate": order.rate, "cutoff": order.cutoff, "skip": skip}
    metadata = metadata_of("replay", scene, {**inputs, "reference": known[1]}, {})
    counts = {"played": played, "answered": answered}
    return Result(
        comparison.tables, {**metadata, **comparison.metadata, **counts, "stamps": "recorded"}
    )


@dataclass(frozen=True)
class Replay:
    """A bag that is played to a node, and how.

    Attributes:
        bag: Bag to play.
        scene: Scene of the node.
        out: Bag for the output of the node.
        rate: Speed factor; 0 plays as fast as the node answers.
        topic: JointState topic of the bag.
        cutoff: Half-power frequency of the filters with which the node differentiates [Hz].
    """

    bag: Path
    scene: Path
    out: Path
    rate: float = 1.0
    topic: str = "/joint_states"
    cutoff: float = 5.0


def play(replay: Replay) -> tuple[int, int]:
    """Play a bag to the node and record its answers.

    The node runs on a DDS domain of its own, which never leaves this machine, with the time of the
    bag. SIGTERM ends a replay like Ctrl-C.

    Returns:
        Numbers of played and of answered joint states.

    Raises:
        MbdError: The bag does not fit the scene, or the node does not start or fails.
    """
    _check(replay)
    scene = load_scene(replay.scene)
    topics, remapped = _motion_topics(scene, replay.topic)
    for name, wrench in scene.wrenches.items():
        topics[wrench.topic or f"{NODE}/wrench/{name}"] = WRENCH
    messages = [
        (raw.topic, raw.log_time, _message(replay.bag, raw))
        for raw in raw_messages(replay.bag, topics)
    ]
    answers = (TORQUES, CONSTRAINT_FORCES) if scene.couplings.dependent else (TORQUES,)
    with (
        BagWriter(replay.out) as bag,
        isolated_domain() as domain,
        _node_process(replay, domain.environment, remapped) as process,
    ):
        player = BagPlayer(topics, answers, bag, process, domain.check)
        player.wait_for_node()
        player.play(messages, next(iter(topics)), replay.rate)
        return player.played, player.answered


def _check(replay: Replay) -> None:
    if not 0 <= replay.rate < math.inf:
        raise ReplayError(f"rate {replay.rate:g} must be finite and >= 0")
    if replay.out.resolve() == replay.bag.resolve():
        raise ReplayError(
            f"{replay.out}: the output would replace the bag that is played; choose another name"
        )


class ReplayError(MbdError):
    """A replay is not possible, or the node failed."""


def _motion_topics(scene: Scene, topic: str) -> tuple[dict[str, str], dict[str, str]]:
    """Return the topics of the bag with the motion and their types, and their names in the node.

    Args:
        scene: Scene of the node.
        topic: Joint states of the only robot; topics of further robots are in its namespace.
    """
    topics, remapped = {}, {}
    named = by_member([joint.name for joint in scene.robot.joints], scene.robot.members)
    bodies = [base.name for base in scene.robot.bases]
    for member in named or ([] if bodies else [""]):
        name = joint_state_topic(member)
        in_bag = beside(topic, name) if member else topic
        topics[in_bag] = JOINT_STATE
        remapped[name] = in_bag
    for body in bodies:
        name = odometry_topic(body)
        topics[beside(topic, name)] = ODOMETRY
        remapped[name] = beside(topic, name)
    return topics, remapped


def _message(bag: Path, raw: RawMessage) -> Any:
    try:
        return deserialize_message(raw.cdr, CLASSES[raw.msgtype])
    except rclpy_implementation.RMWError as error:
        raise DataError(f"{bag}: topic {raw.topic}: unreadable message ({error})") from error


@contextmanager
def _node_process(
    replay: Replay, environment: dict[str, str], remapped: dict[str, str]
) -> Iterator[subprocess.Popen[bytes]]:
    parameters = {
        "scene": str(replay.scene.resolve()),
        "use_sim_time": "true",
        "cutoff": str(replay.cutoff),
        "wrench_wait": str(_WRENCH_WAIT),
        "clock_tolerance": str(_CLOCK_TOLERANCE),
        "allow_code": str(is_permitted()).lower(),
    }
    command = [sys.executable, "-m", "mbd_ros.nodes", "inverse_dynamics", "--ros-args"]
    for name, value in parameters.items():
        command += ["-p", f"{name}:={value}"]
    for name, in_bag in remapped.items():
        command += ["-r", f"{name}:={in_bag}"]
    process = subprocess.Popen(command, env=environment)
    try:
        yield process
        process.send_signal(signal.SIGINT)
        try:
            code = process.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired as error:
            raise ReplayError(f"the node did not stop within {_STOP_TIMEOUT:g} s") from error
        if code != 0:
            raise ReplayError(f"the node ended with exit code {code}")
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def compare(
    estimate: tuple[Path, str],
    reference: tuple[Path, str],
    joints: Sequence[str],
    skip: float,
    say: Callable[[str], None],
    members: Collection[str] = (),
) -> Result:
    """Compare the efforts of two topics.

    Args:
        estimate: Bag and JointState topic of the torques.
        reference: Bag and JointState topic of the reference.
        joints: Joints to compare.
        skip: Time at the start that the errors leave out [s].
        say: Called with the table of errors, line by line.
        members: Names of robots before those of their joints; each has a topic in the namespace
            of the reference.

    Returns:
        Tables of `TorqueErrors`; metadata `overall`, and `overall_whole` without `skip`.
    """
    if not 0 <= skip < math.inf:
        raise DataError(f"skip {skip:g} s must be finite and >= 0")
    estimated = read_motion(estimate[0], joints, topic=estimate[1], required=()).motion
    known = read_motion(
        reference[0], joints, topic=reference[1], required=(), members=members
    ).motion
    if known.effort is None:
        say(f"{reference[0]}: no effort on {reference[1]}: nothing to compare with")
    errors = TorqueErrors(estimated, known, skip)
    errors_with_start = TorqueErrors(estimated, known, 0.0)
    overall = {"overall": errors.overall, "overall_whole": errors_with_start.overall}
    result = Result(errors.tables(), {key: v for key, v in overall.items() if math.isfinite(v)})
    if known.effort is None:
        return result
    say(f"against the effort on {reference[1]}, without the first {skip:g} s:")
    if not errors.samples:
        say("there is no sample to compare")
        return result
    for line in errors.lines():
        say(line)
    say(f"overall with the first {skip:g} s: {100 * errors_with_start.overall:.3f} %")
    return result


class TorqueErrors:
    """Root mean square errors of the torques of a recording against those of another one.

    The reference is interpolated at the stamps of the estimate; samples outside of it are omitted.

    Args:
        estimate: Recording of the estimated efforts.
        reference: Recording of the reference efforts of the same joints.
        skip: Time at the start that is omitted, while filters and controllers settle [s].

    Attributes:
        joints: Joints that the reference contains.
        rms_error: Errors of the joints [N·m or N], shape (len(joints),).
        rms_reference: Reference efforts of the joints [N·m or N], shape (len(joints),).
        overall: Norm of all errors over norm of all references [-].
        samples: Number of compared samples.
        stamps: Times of the samples [ns], shape (samples,).
        estimate: Estimated efforts [N·m or N], shape (samples, len(joints)).
        known: Reference efforts [N·m or N], shape (samples, len(joints)).
    """

    def __init__(self, estimate: Motion, reference: Motion, skip: float) -> None:
        columns = [i for i in range(len(estimate.names)) if _is_known(reference, i)]
        self.joints = tuple(estimate.names[i] for i in columns)
        begin = max(reference.stamps[0], estimate.stamps[0] + int(skip * 1e9))
        is_compared = (estimate.stamps >= begin) & (estimate.stamps <= reference.stamps[-1])
        stamps = estimate.stamps[is_compared]
        assert estimate.effort is not None
        known = np.empty((len(stamps), len(columns)))
        for i, column in enumerate(columns):
            known[:, i] = _interpolate(reference, column, stamps)
        error = estimate.effort[is_compared][:, columns] - known
        self.samples, self.stamps = len(stamps), stamps
        self.estimate, self.known = estimate.effort[is_compared][:, columns], known
        self.rms_error, self.rms_reference = _rms(error), _rms(known)
        total = float(np.linalg.norm(known))
        self.overall = float(np.linalg.norm(error)) / total if total > 0 else float("inf")

    def lines(self) -> Iterator[str]:
        """Yield the lines of the table."""
        yield f"{'joint':<28}{'rms error':>12}{'rms reference':>16}{'error':>10}"
        for name, error, reference in zip(
            self.joints, self.rms_error, self.rms_reference, strict=True
        ):
            share = f"{100 * error / reference:.3f} %" if reference > 0 else "-"
            yield f"{name:<28}{error:>12.5g}{reference:>16.5g}{share:>10}"
        yield f"overall {100 * self.overall:.3f} % (norm of errors over norm of references)"

    def tables(self) -> dict[str, Table]:
        """Return `samples`: estimate, reference and error over time; `errors`: a row per joint."""
        kinds = {
            "effort": self.estimate,
            "reference": self.known,
            "error": self.estimate - self.known,
        }
        columns = time_columns(self.stamps)
        for kind, values in kinds.items():
            for name, column in zip(self.joints, values.T, strict=True):
                columns.append(Column(f"{name}.{kind}", column, UNIT))
        errors = [
            Column("joint", np.array(self.joints, dtype=np.str_)),
            Column("rms_error", self.rms_error, UNIT),
            Column("rms_reference", self.rms_reference, UNIT),
        ]
        return {MAIN: Table(columns), "errors": Table(errors)}


def _is_known(reference: Motion, column: int) -> bool:
    return reference.effort is not None and bool(np.isfinite(reference.effort[:, column]).any())


def _interpolate(reference: Motion, column: int, stamps: np.ndarray) -> Array:
    assert reference.effort is not None
    finite = np.isfinite(reference.effort[:, column])
    # Differences, since nanoseconds since 1970 have more digits than a float.
    begin = reference.stamps[0]
    values = reference.effort[finite, column]
    return np.interp(stamps - begin, reference.stamps[finite] - begin, values)


def _rms(values: Array) -> Array:
    return np.sqrt(np.sum(values**2, axis=0) / max(len(values), 1))


class BagPlayer:
    """Publisher of the messages of a bag at their times, which also records the answers.

    Args:
        topics: Topics to publish and their types.
        answers: Topics on which the node answers every joint state.
        bag: Bag for the answers.
        process: Process of the node.
        check: Function that raises when the replay shall end; it is called often.

    Attributes:
        played: Number of published joint states.
    """

    def __init__(
        self,
        topics: dict[str, str],
        answers: Sequence[str],
        bag: BagWriter,
        process: subprocess.Popen[bytes],
        check: Callable[[], None],
    ) -> None:
        self.played = 0
        self._lost = 0
        self._check = check
        self._answers = dict.fromkeys(answers, 0)
        self._bag = bag
        self._process = process
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
        """Number of joint states that were answered on every topic."""
        return min(self._answers.values())

    def wait_for_node(self) -> None:
        """Wait until the node is active and connected on every topic.

        Raises:
            ReplayError: The node does not start (the message names the reason), or another
                program publishes its topics.
        """
        deadline = time.monotonic() + _START_TIMEOUT
        while True:
            self._spin(_SPIN_TIME)
            self._check_alone()
            is_heard = all(p.get_subscription_count() for p in self._publishers.values())
            has_answers = all(s.get_publisher_count() for s in self._subscriptions)
            if self._state == "active" and is_heard and has_answers:
                return
            if self._state == "unconfigured" or self._process.poll() is not None:
                raise ReplayError(f"the node did not start: {self._health or 'it ended'}")
            if time.monotonic() > deadline:
                raise ReplayError(f"the node did not start within {_START_TIMEOUT:g} s")

    def play(self, messages: Sequence[tuple[str, int, Any]], topic: str, rate: float) -> None:
        """Publish all messages, then wait for the last answers.

        Args:
            messages: Topics, log times [ns] and messages.
            topic: Topic of the joint states.
            rate: Speed factor; 0 plays as fast as the node answers.

        Raises:
            ReplayError: The node ends, becomes inactive or does not answer, or another program
                publishes its topics.
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
        self._check()  # first: Ctrl-C ends the node, too
        self._check_alone()
        code = self._process.poll()
        if code is not None or self._state != "active":
            state = f"is {self._state}" if code is None else f"ended with exit code {code}"
            raise ReplayError(f"the node {state}: {self._health}")

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
            self._spin(_SPIN_TIME)
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
            self._spin(min(left, _SPIN_TIME))

    def _spin(self, timeout: float) -> None:
        self._check()
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
