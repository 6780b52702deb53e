"""A bag through the live node, which runs as its own process: `mbd-ros replay`.

The torques of the node are compared with a reference, joint by joint.
"""

import math
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message

from mbd_ros.core.state import Array, Motion
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
from mbd_ros.files.bags.bag_reader import RawMessage, raw_messages
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.table import MAIN, Column, Result, Table, time_columns
from mbd_ros.files.topics import beside, by_member, joint_state_topic, odometry_topic
from mbd_ros.jobs.isolated_domain import isolated_domain
from mbd_ros.motion.recordings import metadata_of, read_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import is_permitted

UNIT = "N·m or N"
_STOP_TIMEOUT = 10.0  # [s] until the node must have ended
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


def _check(replay: Replay) -> None:
    if not 0 <= replay.rate < math.inf:
        raise ReplayError(f"rate {replay.rate:g} must be finite and >= 0")
    if replay.out.resolve() == replay.bag.resolve():
        raise ReplayError(f"{replay.out}: the output would replace the bag that is played")


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


def compare(
    estimate: tuple[Path, str],
    reference: tuple[Path, str],
    joints: Sequence[str],
    skip: float,
    say: Callable[[str], None],
    members: Collection[str] = (),
) -> Result:
    """Compare two topics.

    Args:
        estimate: Bag and JointState topic of the torques.
        reference: Bag and JointState topic of the true ones.
        joints: Joints to compare.
        skip: Time left out at the start [s].
        say: Is told the table of errors, a line each.
        members: Names of robots in front of those of their joints, each of which has a topic of
            true ones beside the reference.

    Returns:
        Tables of `TorqueErrors`; metadata `overall`, and `overall_whole` without skipping.
    """
    if not 0 <= skip < math.inf:
        raise DataError(f"skip {skip:g} s must be finite and >= 0")
    judged = read_motion(estimate[0], joints, topic=estimate[1], required=()).motion
    known = read_motion(
        reference[0], joints, topic=reference[1], required=(), members=members
    ).motion
    if known.effort is None:
        say(f"{reference[0]}: no effort on {reference[1]}: nothing to compare with")
    settled, whole = TorqueErrors(judged, known, skip), TorqueErrors(judged, known, 0.0)
    overall = {"overall": settled.overall, "overall_whole": whole.overall}
    result = Result(settled.tables(), {key: v for key, v in overall.items() if math.isfinite(v)})
    if known.effort is None:
        return result
    say(f"against the effort on {reference[1]}, without the first {skip:g} s:")
    if not settled.samples:
        say("no sample is left to compare")
        return result
    for line in settled.lines():
        say(line)
    say(f"overall with the first {skip:g} s: {100 * whole.overall:.3f} %")
    return result


class TorqueErrors:
    """Root mean square errors of one recording of torques against another.

    The reference is interpolated to the stamps of the estimate; samples outside of it are left
    out.

    Args:
        estimate: Recording whose efforts are judged.
        reference: Recording of the same joints with the efforts to compare with.
        skip: Time left out at the start, where filters and controllers settle [s].

    Attributes:
        joints: Joints that the reference has.
        rms_error: [N·m or N], shape (len(joints),).
        rms_reference: [N·m or N], shape (len(joints),).
        overall: Norm of all errors over norm of all references.
        samples: Number of samples that are judged.
        stamps: Theirs [ns], shape (samples,).
        estimate: Their efforts [N·m or N], shape (samples, len(joints)).
        known: Those of the reference, same shape.
    """

    def __init__(self, estimate: Motion, reference: Motion, skip: float) -> None:
        columns = [i for i in range(len(estimate.names)) if _is_known(reference, i)]
        self.joints = tuple(estimate.names[i] for i in columns)
        begin = max(reference.stamps[0], estimate.stamps[0] + int(skip * 1e9))
        judged = (estimate.stamps >= begin) & (estimate.stamps <= reference.stamps[-1])
        stamps = estimate.stamps[judged]
        assert estimate.effort is not None
        known = np.empty((len(stamps), len(columns)))
        for i, column in enumerate(columns):
            known[:, i] = _interpolate(reference, column, stamps)
        error = estimate.effort[judged][:, columns] - known
        self.samples, self.stamps = len(stamps), stamps
        self.estimate, self.known = estimate.effort[judged][:, columns], known
        self.rms_error, self.rms_reference = _rms(error), _rms(known)
        total = float(np.linalg.norm(known))
        self.overall = float(np.linalg.norm(error)) / total if total > 0 else float("inf")

    def lines(self) -> Iterator[str]:
        """The table, a line each."""
        yield f"{'joint':<28}{'rms error':>12}{'rms reference':>16}{'error':>10}"
        for name, error, reference in zip(
            self.joints, self.rms_error, self.rms_reference, strict=True
        ):
            share = f"{100 * error / reference:.3f} %" if reference > 0 else "-"
            yield f"{name:<28}{error:>12.5g}{reference:>16.5g}{share:>10}"
        yield f"overall {100 * self.overall:.3f} % (norm of errors over norm of references)"

    def tables(self) -> dict[str, Table]:
        """`samples`: estimate, reference and error by time; `errors`: a row a joint."""
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
