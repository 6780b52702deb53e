"""Motions and wrenches out of bags: joint states, odometry of free bodies, loads.

JointStates are read as arrays, whole blocks of one layout or else message by message.
`MotionBlocks` gives a motion piece by piece, in memory that does not grow with the recording.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.poses import with_continuous_signs
from mbd_ros.core.state import Array, BodyMotion, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import beside, by_member, joint_state_topic, odometry_topic
from mbd_ros.files.bags.bag_reader import CORRUPT, RawBlock, messages, raw_blocks, topic_types
from mbd_ros.files.bags.bag_types import JOINT_STATE, ODOMETRY, WRENCH, from_cdr
from mbd_ros.files.recording import NO_BODIES, Recording
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateRowsReader
from msg_adapters.pose import OdometrySample, read_odometry
from msg_adapters.wrench import WrenchSample, read_wrench

_LEAST = 16_384  # messages of a piece, but of the last
Timed = tuple[int, JointSample | WrenchSample | OdometrySample]  # log time [ns] and sample


def bag_motion(path: Path, topic: str, wanted: Wanted) -> Recording:
    """Return the motion of joints and free bodies that messages of equal stamps tell.

    Args:
        topic: Of the joint states of the only robot; the others are beside it.
        wanted: What is read.
    """
    dropped = Counter[str]()
    streams = {}
    for member, joints in by_member(wanted.joints, wanted.members).items():
        its = beside(topic, joint_state_topic(member)) if member else topic
        needed = [own for own, name in joints.items() if name in wanted.needed]
        if needed or its in topic_types(path) or not (member or wanted.bodies):
            streams[its] = joint_samples(path, list(joints), its, needed, dropped)
    for body, link in wanted.bodies.items():
        its = beside(topic, odometry_topic(body))
        streams[its] = _body_samples(path, its, link, dropped)
    stamps, paired, by_log_time = _paired(path, streams, dropped)
    return Recording(_motion(topic, wanted, stamps, paired), dropped, by_log_time)


class Wanted(NamedTuple):
    """Joints, bodies and quantities that a motion needs.

    Attributes:
        joints: Names, in the order of the columns.
        needed: Those that must have a finite position.
        bodies: Free bodies, which must have a pose, and the link that stands for each.
        members: Names of robots and bodies in front of those of their joints, see `topics`.
    """

    joints: tuple[str, ...]
    needed: tuple[str, ...] = ()
    bodies: Mapping[str, str] = NO_BODIES
    members: frozenset[str] = frozenset()


def joint_samples(
    path: Path, joints: Sequence[str], topic: str, needed: Sequence[str], dropped: Counter[str]
) -> Samples:
    """Position, velocity and effort of each JointState that can be used."""
    joint_states = JointStates(path, topic, joints, needed, dropped)
    parts = [joint_states.of(block) for block in raw_blocks(path, topic, JOINT_STATE)]
    joint_states.check([part for part in parts if len(part.stamps)])
    return joined(parts)


class Samples(NamedTuple):
    """Messages of a topic that can be used.

    Attributes:
        log_times: [ns], shape (n,).
        stamps: Those of the headers [ns], shape (n,).
        fields: What the messages carry, one a row each.
    """

    log_times: NDArray[np.int64]
    stamps: NDArray[np.int64]
    fields: tuple[Array, ...]


class JointStates:
    """Samples out of blocks of JointStates: whole blocks of one layout, else message by message.

    Args:
        path: The bag, for messages.
        joints: In the order of the fields.
        needed: Those that must have a finite position.
        dropped: Counts the messages that cannot be used, by reason.

    Attributes:
        seen: Joints of all messages.
    """

    def __init__(
        self,
        path: Path,
        topic: str,
        joints: Sequence[str],
        needed: Sequence[str],
        dropped: Counter[str],
    ) -> None:
        self._where, self._dropped, self._joints = f"{path}: topic {topic}", dropped, joints
        self._needed = needed
        self._reader = JointStateReader(joints)
        self._rows = JointStateRowsReader(self._reader, self._message)
        self._used = [self._reader.names.index(name) for name in needed]
        self.seen = set[str]()

    def of(self, block: RawBlock) -> Samples:
        """Samples of a block."""
        rows = block.rows()
        samples = None if rows is None else self._rows.read(rows)
        if samples is None or not np.isfinite(samples.position[:, self._used]).all():
            return self._one_by_one(block)
        self.seen.update(self._reader.carried)
        return Samples(block.log_times, samples[0], samples[1:])

    def check(self, used: Sequence[object]) -> None:
        """Raise DataError where a needed joint is in no message, or none can be used."""
        lacking = [name for name in self._needed if name not in self.seen]
        if lacking:
            there = ", ".join(sorted(self.seen)) or "none"
            raise DataError(f"{self._where}: no joint {', '.join(lacking)}; there are: {there}")
        check_any(self._where, used, self._dropped)

    def _message(self, cdr: bytes) -> Any:
        try:
            return from_cdr(cdr, JOINT_STATE)
        except (DataError, *CORRUPT) as error:
            raise DataError(f"{self._where}: unreadable message ({error})") from error

    def _one_by_one(self, block: RawBlock) -> Samples:
        samples: list[tuple[int, JointSample]] = []
        for log_time, cdr in block.messages():
            message = self._message(cdr)
            self.seen.update(message.name)
            try:
                sample = self._reader.read(message)
            except MessageError as error:
                self._dropped[str(error)] += 1
                continue
            bad = [self._joints[i] for i in self._used if not np.isfinite(sample.position[i])]
            if bad:
                self._dropped[f"position of {', '.join(bad)} is missing or not finite"] += 1
            else:
                samples.append((log_time, sample))
        shape = len(samples), len(self._joints)
        fields = (np.array([s[1 + i] for _, s in samples]).reshape(shape) for i in range(3))
        return Samples(*times_of(samples), tuple(fields))


def check_any(where: str, samples: Sequence[object], dropped: Counter[str]) -> None:
    """Raise DataError where no message of a topic can be used."""
    if not samples:
        raise DataError(f"{where}: no usable message, dropped: {dict(dropped)}")


def times_of(samples: Sequence[Timed]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Log times and stamps of samples [ns]."""
    pairs = [(log_time, sample.stamp) for log_time, sample in samples]
    log_times, stamps = np.array(pairs, np.int64).reshape(-1, 2).T
    return log_times, stamps


def joined(parts: Sequence[Samples]) -> Samples:
    """Samples after each other."""
    if len(parts) == 1:
        return parts[0]
    fields = tuple(np.concatenate(each) for each in zip(*(p.fields for p in parts), strict=True))
    log_times, stamps = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    return Samples(log_times, stamps, fields)


def _body_samples(path: Path, topic: str, link: str, dropped: Counter[str]) -> Samples:
    """Pose and twist of each Odometry that can be used."""
    samples: list[tuple[int, OdometrySample]] = []
    for _, log_time, msg in messages(path, {topic: ODOMETRY}):
        try:
            samples.append((log_time, read_odometry(msg, link)))
        except MessageError as error:
            dropped[f"{topic}: {str(error).partition(':')[0]}"] += 1
    check_any(f"{path}: topic {topic}", samples, dropped)
    fields = np.array([s.pose for _, s in samples]), np.array([s.twist for _, s in samples])
    return Samples(*times_of(samples), fields)


def _paired(
    path: Path, streams: Mapping[str, Samples], dropped: Counter[str]
) -> tuple[NDArray[np.int64], dict[str, tuple[Array, ...]], bool]:
    """Stamps that all streams have, their fields by topic, and whether they are log times.

    Raises:
        DataError: Messages of several topics have no stamps, or none in common.
    """
    clocks = {topic: _clock(*samples[:2], dropped) for topic, samples in streams.items()}
    by_log_time = any(clock[2] for clock in clocks.values())
    if by_log_time and len(streams) > 1:
        raise DataError(
            f"{path}: {', '.join(streams)}: messages are paired by stamps, and some are 0"
        )
    common = reduce(np.intersect1d, [clock[0] for clock in clocks.values()])
    if not len(common):
        raise DataError(f"{path}: {', '.join(streams)}: no stamp that all of them have")
    paired = {}
    for topic, (stamps, order, _) in clocks.items():
        if len(common) < len(stamps):
            dropped[f"{topic}: no message of its stamp on the other topics"] += len(stamps) - len(
                common
            )
            order = order[np.isin(stamps, common)]
        fields = streams[topic].fields
        whole = len(order) == len(streams[topic].stamps)
        paired[topic] = fields if whole else tuple(field[order] for field in fields)
    return common, paired, by_log_time


def _clock(
    log_times: NDArray[np.int64], stamps: NDArray[np.int64], dropped: Counter[str]
) -> tuple[NDArray[np.int64], NDArray[np.intp], bool]:
    """Strictly increasing stamps, the samples they belong to, and whether they are log times."""
    by_log_time = not stamps.all()
    if by_log_time:
        stamps = log_times
    newest = np.maximum.accumulate(stamps)
    kept = np.flatnonzero(np.r_[True, stamps[1:] > newest[:-1]])
    if kept.size < stamps.size:
        dropped["stamp is not newer than all before"] += int(stamps.size - kept.size)
    return stamps[kept], kept, by_log_time


def _motion(
    topic: str, wanted: Wanted, stamps: NDArray[np.int64], paired: Mapping[str, tuple[Array, ...]]
) -> Motion:
    """The motion of samples by topic, all of the same stamps."""
    joints = by_member(wanted.joints, wanted.members)
    if list(joints.values()) == [{name: name for name in wanted.joints}] and topic in paired:
        position, velocity, effort = paired[topic]
    else:
        position, velocity, effort = (
            np.full((len(stamps), len(wanted.joints)), np.nan) for _ in "pve"
        )
        for member, own in joints.items():
            its = beside(topic, joint_state_topic(member)) if member else topic
            at = [wanted.joints.index(name) for name in own.values()]
            if its in paired:
                for whole, part in zip((position, velocity, effort), paired[its], strict=True):
                    whole[:, at] = part
    bodies = []
    for body in wanted.bodies:
        pose, twist = paired[beside(topic, odometry_topic(body))]
        bodies.append(BodyMotion(body, with_continuous_signs(pose), _absent_if_nan(twist)))
    fields = without_infinite(position), _absent_if_nan(without_infinite(velocity)), None
    return Motion(
        wanted.joints,
        stamps,
        *fields,
        _absent_if_nan(without_infinite(effort)),
        None,
        tuple(bodies),
    )


def _absent_if_nan(values: Array) -> Array | None:
    return None if np.isnan(values).all() else values


def without_infinite(values: np.ndarray) -> np.ndarray:
    """Values whose infinite ones are absent."""
    if np.isinf(values).any():
        values = np.where(np.isinf(values), np.nan, values)
    return values


class MotionBlocks:
    """Pieces of the motion of a bag; together they are what `read_motion` gives.

    Args:
        joints: Names, in the order of the columns.
        needed: Those that must have a finite position.

    Attributes:
        dropped: Messages left out, counted by reason; complete after the last piece.
    """

    def __init__(
        self, path: Path, topic: str, joints: Sequence[str], needed: Sequence[str]
    ) -> None:
        self._path, self._topic = path, topic
        self._joints, self._needed = tuple(joints), tuple(needed)
        self.dropped = Counter[str]()

    def __iter__(self) -> Iterator[Motion]:
        """The pieces.

        Raises:
            WholeNeededError: A stamp is 0, so that those of the log count from the beginning on.
        """
        self.dropped.clear()
        states = JointStates(self._path, self._topic, self._joints, self._needed, self.dropped)
        newest, old, used = np.iinfo(np.int64).min, 0, []
        for samples in self._pieces(states):
            if not samples.stamps.all():
                raise WholeNeededError(f"{self._path}: topic {self._topic}: a stamp is 0")
            before = np.maximum.accumulate(np.r_[newest, samples.stamps[:-1]])
            is_new = samples.stamps > before
            old += int((~is_new).sum())
            newest = max(before[-1], samples.stamps[-1])
            if is_new.any():
                used = [newest]
                yield self._motion(samples, slice(None) if is_new.all() else is_new)
        states.check(used)
        if old:
            self.dropped["stamp is not newer than all before"] += old

    def _pieces(self, states: JointStates) -> Iterator[Samples]:
        waiting: list[Samples] = []
        for block in raw_blocks(self._path, self._topic, JOINT_STATE):
            samples = states.of(block)
            if len(samples.stamps):
                waiting.append(samples)
            if sum(len(one.stamps) for one in waiting) >= _LEAST:
                yield joined(waiting)
                waiting = []
        if waiting:
            yield joined(waiting)

    def _motion(self, samples: Samples, rows: slice | np.ndarray) -> Motion:
        fields = (without_infinite(field[rows]) for field in samples.fields)
        position, velocity, effort = fields
        return Motion(self._joints, samples.stamps[rows], position, velocity, effort=effort)


class WholeNeededError(DataError):
    """A recording that can be read as a whole only."""


def bag_wrenches(
    path: Path, names: Mapping[str, str | None], dropped: Counter[str]
) -> dict[str, WrenchSamples]:
    """Return the wrenches of loads by name, each from its topic; `dropped` counts the rest."""
    topics = {name: _topic(path, name, topic) for name, topic in names.items()}
    samples: dict[str, list[Timed]] = {topic: [] for topic in topics.values()}
    for topic, log_time, msg in messages(path, dict.fromkeys(samples, WRENCH)):
        try:
            samples[topic].append((log_time, read_wrench(msg)))
        except MessageError as error:
            dropped[f"{topic}: {str(error).partition(':')[0]}"] += 1
    read = {
        topic: _wrench_samples(path, topic, taken, dropped) for topic, taken in samples.items()
    }
    return {name: read[topic] for name, topic in topics.items()}


def _topic(path: Path, name: str, topic: str | None) -> str:
    if not topic:
        raise DataError(f"{path}: load {name} names no topic, which a bag needs")
    return topic if topic.startswith("/") else f"/{topic}"


def _wrench_samples(
    path: Path, topic: str, samples: list[Timed], dropped: Counter[str]
) -> WrenchSamples:
    check_any(f"{path}: topic {topic}", samples, dropped)
    frames = sorted({sample.frame_id for _, sample in samples})
    if len(frames) > 1:
        raise DataError(f"{path}: topic {topic}: frame_id changes between {', '.join(frames)}")
    stamps, kept, _ = _clock(*times_of(samples), dropped)
    return WrenchSamples(stamps, np.array([samples[i][1].wrench for i in kept]), frames[0])
