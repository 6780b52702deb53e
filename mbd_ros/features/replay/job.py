"""A bag through the live node, which runs as its own process: `mbd-ros replay`."""

import math
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message

from mbd_ros.errors import DataError
from mbd_ros.features.replay.bag_player import (
    CLASSES,
    CONSTRAINT_FORCES,
    JOINT_STATE,
    NODE,
    ODOMETRY,
    TORQUES,
    WRENCH,
    BagPlayer,
    ReplayError,
)
from mbd_ros.features.replay.torque_errors import compare
from mbd_ros.files.bags.bags import BagWriter, RawMessage, raw_messages
from mbd_ros.files.table import Result
from mbd_ros.files.topics import beside, by_member, joint_state_topic, odometry_topic
from mbd_ros.jobs.isolated_domain import isolated_domain
from mbd_ros.motion.result_metadata import metadata_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import is_permitted

_STOP_TIMEOUT = 10.0  # s
_WRENCH_WAIT = 1.0  # s: better a late answer than one without its wrench
_CLOCK_TOLERANCE = 1e10  # s: recorders and robots may live in different times


@dataclass(frozen=True)
class Replay:
    """Order of a replay.

    Attributes:
        bag: Recording to play.
        scene: Scene of the node.
        out: Bag of the answers of the node.
        rate: Speed factor; 0 plays as fast as the node answers.
        topic: JointState topic of the bag.
        cutoff: Half-power frequency of the node's derivative filters [Hz].
    """

    bag: Path
    scene: Path
    out: Path
    rate: float
    topic: str
    cutoff: float


def replay(
    asked: Replay, reference: str | None, skip: float, say: Callable[[str], None]
) -> Result:
    """Play a bag to the node and compare its torques.

    Args:
        asked: What to play and how.
        reference: JointState topic of the bag to compare with; None: the one that is played.
        skip: Time left out of the errors at the start [s].
        say: Is told the numbers of messages and the table of errors, a line each.

    Returns:
        As `compare`; metadata `played` and `answered` as well.

    Raises:
        MbdError: As `play`, or what it answered cannot be compared.
    """
    scene = load_scene(asked.scene)
    played, answered = play(asked)
    say(f"{played} joint states played, {answered} answered, {played - answered} lost")
    known = asked.bag, reference or asked.topic
    joints, members = scene.couplings.independent, scene.robot.members
    found = compare((asked.out, TORQUES), known, joints, skip, say, members)
    inputs = {"bag": asked.bag, "rate": asked.rate, "cutoff": asked.cutoff, "skip": skip}
    metadata = metadata_of("replay", scene, {**inputs, "reference": known[1]}, {})
    counts = {"played": played, "answered": answered}
    return Result(found.tables, {**metadata, **found.metadata, **counts, "stamps": "recorded"})


def play(replay: Replay) -> tuple[int, int]:
    """Play a bag to the node and record the answers.

    Both run on a DDS domain of their own, which never leaves this machine, under the time of the
    bag. SIGTERM ends a replay as Ctrl-C does.

    Returns:
        Numbers of joint states played and answered.

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
        isolated_domain() as environment,
        BagWriter(replay.out) as bag,
        _node_process(replay, environment, remapped) as process,
    ):
        player = BagPlayer(topics, answers, bag, process)
        player.wait_for_node()
        player.play(messages, next(iter(topics)), replay.rate)
        return player.played, player.answered


def _motion_topics(scene: Scene, topic: str) -> tuple[dict[str, str], dict[str, str]]:
    """Topics of the bag that carry the motion, with their types, and the node's names of them.

    Args:
        scene: The scene.
        topic: Joint states of the only robot; the others are beside it.
    """
    topics, remapped = {}, {}
    named = by_member([joint.name for joint in scene.robot.joints], scene.robot.members)
    bodies = [base.name for base in scene.robot.bases]
    for member in named or ([] if bodies else [""]):
        own = joint_state_topic(member)
        there = beside(topic, own) if member else topic
        topics[there], remapped[own] = JOINT_STATE, there
    for body in bodies:
        own = odometry_topic(body)
        topics[beside(topic, own)], remapped[own] = ODOMETRY, beside(topic, own)
    return topics, remapped


def _check(replay: Replay) -> None:
    if not 0 <= replay.rate < math.inf:
        raise ReplayError(f"rate {replay.rate:g} must be finite and >= 0")
    if replay.out.resolve() == replay.bag.resolve():
        raise ReplayError(f"{replay.out}: the output would replace the bag that is played")


def _message(bag: Path, raw: RawMessage) -> Any:
    try:
        return deserialize_message(raw.cdr, CLASSES[raw.msgtype])
    except rclpy_implementation.RMWError as error:
        raise DataError(f"{bag}: topic {raw.topic}: unreadable message ({error})") from error


@contextmanager
def _node_process(
    replay: Replay, environment: dict[str, str], remapped: dict[str, str]
) -> Iterator["subprocess.Popen[bytes]"]:
    parameters = {
        "scene": str(replay.scene.resolve()),
        "use_sim_time": "true",
        "cutoff": str(replay.cutoff),
        "wrench_wait": str(_WRENCH_WAIT),
        "clock_tolerance": str(_CLOCK_TOLERANCE),
        "allow_code": str(is_permitted()).lower(),
    }
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", "mbd_ros.nodes", "inverse_dynamics", "--ros-args", *words]
    for own, there in remapped.items():
        command += ["-r", f"{own}:={there}"]
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
