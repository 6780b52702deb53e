"""Joint states and wrenches out of bags."""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.poses import with_steady_signs
from mbd_ros.core.state import Array, BodyMotion, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.bags import messages, topic_types
from mbd_ros.files.recording import NO_BODIES, Recording
from mbd_ros.files.topics import beside, by_member, joint_state_topic, odometry_topic
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.odometry import OdometrySample, read_odometry
from msg_adapters.wrench import WrenchSample, read_wrench

JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
ODOMETRY = "nav_msgs/msg/Odometry"

_Timed = tuple[int, JointSample | WrenchSample | OdometrySample]  # log time [ns] and sample


class Wanted(NamedTuple):
    """What is wanted of a motion.

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


def bag_motion(path: Path, topic: str, wanted: Wanted) -> Recording:
    """See `recordings.read_motion`.

    Args:
        path: The bag.
        topic: Of the joint states of the only robot; the others are beside it.
        wanted: What is read.
    """
    dropped = Counter[str]()
    streams = {}
    for member, joints in by_member(wanted.joints, wanted.members).items():
        its = beside(topic, joint_state_topic(member)) if member else topic
        needed = [own for own, name in joints.items() if name in wanted.needed]
        if needed or its in topic_types(path) or not (member or wanted.bodies):
            streams[its] = _joint_samples(path, list(joints), its, needed, dropped)
    for body, link in wanted.bodies.items():
        its = beside(topic, odometry_topic(body))
        streams[its] = _body_samples(path, its, link, dropped)
    stamps, kept, by_log_time = _paired(path, streams, dropped)
    return Recording(_motion(topic, wanted, stamps, kept), dropped, by_log_time)


def _motion(
    topic: str, wanted: Wanted, stamps: NDArray[np.int64], kept: Mapping[str, Sequence[Any]]
) -> Motion:
    """The motion of samples by topic, all of the same stamps."""
    position, velocity, effort = (
        np.full((len(stamps), len(wanted.joints)), np.nan) for _ in "pve"
    )
    for member, joints in by_member(wanted.joints, wanted.members).items():
        its = beside(topic, joint_state_topic(member)) if member else topic
        at = [wanted.joints.index(name) for name in joints.values()]
        samples = kept.get(its, ())
        for values, field in ((position, 0), (velocity, 1), (effort, 2)):
            if samples:
                values[:, at] = [sample[1 + field] for sample in samples]
    bodies = []
    for body in wanted.bodies:
        samples = kept[beside(topic, odometry_topic(body))]
        pose = with_steady_signs(np.array([sample.pose for sample in samples]))
        bodies.append(BodyMotion(body, pose, _absent_if_nan(np.array([s.twist for s in samples]))))
    fields = _finite(position), _absent_if_nan(_finite(velocity)), None
    return Motion(
        wanted.joints, stamps, *fields, _absent_if_nan(_finite(effort)), None, tuple(bodies)
    )


def _paired(
    path: Path, streams: Mapping[str, Sequence[_Timed]], dropped: Counter[str]
) -> tuple[NDArray[np.int64], dict[str, list[Any]], bool]:
    """Stamps that all streams have, their samples by topic, and whether they are log times.

    Raises:
        DataError: Messages of several topics have no stamps, or none in common.
    """
    clocks = {topic: _clock(samples, dropped) for topic, samples in streams.items()}
    by_log_time = any(clock[2] for clock in clocks.values())
    if by_log_time and len(streams) > 1:
        raise DataError(
            f"{path}: {', '.join(streams)}: messages are paired by stamps, and some are 0"
        )
    common = reduce(np.intersect1d, [clock[0] for clock in clocks.values()])
    if not len(common):
        raise DataError(f"{path}: {', '.join(streams)}: no stamp that all of them have")
    kept = {}
    for topic, (stamps, order, _) in clocks.items():
        is_common = np.isin(stamps, common)
        kept[topic] = [streams[topic][i][1] for i in order[is_common]]
        alone = int((~is_common).sum())
        if alone:
            dropped[f"{topic}: no message of its stamp on the other topics"] += alone
    return common, kept, by_log_time


def _body_samples(path: Path, topic: str, link: str, dropped: Counter[str]) -> list[_Timed]:
    """Log time [ns] and sample of each Odometry that can be used."""
    samples: list[_Timed] = []
    for _, log_time, msg in messages(path, {topic: ODOMETRY}):
        try:
            samples.append((log_time, read_odometry(msg, link)))
        except MessageError as error:
            dropped[f"{topic}: {str(error).partition(':')[0]}"] += 1
    _check_any(path, topic, samples, dropped)
    return samples


def _joint_samples(
    path: Path,
    joints: Sequence[str],
    topic: str,
    needed: Sequence[str],
    dropped: Counter[str],
) -> list[_Timed]:
    """Log time [ns] and sample of each message that can be used."""
    reader = JointStateReader(joints)
    used = [reader.names.index(name) for name in needed]
    samples: list[_Timed] = []
    seen = set[str]()
    for _, log_time, msg in messages(path, {topic: JOINT_STATE}):
        seen.update(msg.name)
        try:
            sample = reader.read(msg)
        except MessageError as error:
            dropped[str(error)] += 1
            continue
        bad = [joints[i] for i in used if not np.isfinite(sample.position[i])]
        if bad:
            dropped[f"position of {', '.join(bad)} is missing or not finite"] += 1
        else:
            samples.append((log_time, sample))
    lacking = [name for name in needed if name not in seen]
    if lacking:
        there = ", ".join(sorted(seen)) or "none"
        raise DataError(
            f"{path}: topic {topic}: no joint {', '.join(lacking)}; there are: {there}"
        )
    _check_any(path, topic, samples, dropped)
    return samples


def _check_any(path: Path, topic: str, samples: Sequence, dropped: Counter[str]) -> None:
    if not samples:
        raise DataError(f"{path}: topic {topic}: no usable message, dropped: {dict(dropped)}")


def _clock(
    samples: Sequence[_Timed], dropped: Counter[str]
) -> tuple[NDArray[np.int64], NDArray[np.intp], bool]:
    """Strictly increasing stamps, the samples they belong to, and whether they are log times."""
    stamps = np.array([sample.stamp for _, sample in samples], dtype=np.int64)
    by_log_time = not stamps.all()
    if by_log_time:
        stamps = np.array([log_time for log_time, _ in samples], dtype=np.int64)
    newest = np.maximum.accumulate(stamps)
    kept = np.flatnonzero(np.r_[True, stamps[1:] > newest[:-1]])
    if kept.size < stamps.size:
        dropped["stamp is not newer than all before"] += int(stamps.size - kept.size)
    return stamps[kept], kept, by_log_time


def _finite(rows: list[Array]) -> Array:
    values = np.array(rows, dtype=np.float64)
    values[~np.isfinite(values)] = np.nan
    return values


def _absent_if_nan(values: Array) -> Array | None:
    return None if np.isnan(values).all() else values


def bag_wrenches(
    path: Path, names: Mapping[str, str | None], dropped: Counter[str]
) -> dict[str, WrenchSamples]:
    """See `recordings.read_wrenches`."""
    topics = {name: _topic(path, name, topic) for name, topic in names.items()}
    samples: dict[str, list[_Timed]] = {topic: [] for topic in topics.values()}
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
    path: Path, topic: str, samples: list[_Timed], dropped: Counter[str]
) -> WrenchSamples:
    _check_any(path, topic, samples, dropped)
    frames = sorted({sample.frame_id for _, sample in samples})
    if len(frames) > 1:
        raise DataError(f"{path}: topic {topic}: frame_id changes between {', '.join(frames)}")
    stamps, kept, _ = _clock(samples, dropped)
    return WrenchSamples(stamps, np.array([samples[i][1].wrench for i in kept]), frames[0])
