"""Joint states and wrenches out of bags."""

from collections import Counter
from collections.abc import Mapping
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.poses import with_steady_signs
from mbd_ros.core.state import Array, BodyMotion, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_joint_states import Samples, Timed, check_any, joint_samples, times_of
from mbd_ros.files.bags.bags import messages, topic_types
from mbd_ros.files.bags.motion_blocks import without_infinite
from mbd_ros.files.recording import NO_BODIES, Recording
from mbd_ros.files.topics import beside, by_member, joint_state_topic, odometry_topic
from msg_adapters.errors import MessageError
from msg_adapters.odometry import OdometrySample, read_odometry
from msg_adapters.wrench import read_wrench

WRENCH = "geometry_msgs/msg/WrenchStamped"
ODOMETRY = "nav_msgs/msg/Odometry"


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
            streams[its] = joint_samples(path, list(joints), its, needed, dropped)
    for body, link in wanted.bodies.items():
        its = beside(topic, odometry_topic(body))
        streams[its] = _body_samples(path, its, link, dropped)
    stamps, kept, by_log_time = _paired(path, streams, dropped)
    return Recording(_motion(topic, wanted, stamps, kept), dropped, by_log_time)


def _motion(
    topic: str, wanted: Wanted, stamps: NDArray[np.int64], kept: Mapping[str, tuple[Array, ...]]
) -> Motion:
    """The motion of samples by topic, all of the same stamps."""
    joints = by_member(wanted.joints, wanted.members)
    if list(joints.values()) == [{name: name for name in wanted.joints}] and topic in kept:
        position, velocity, effort = kept[topic]
    else:
        position, velocity, effort = (
            np.full((len(stamps), len(wanted.joints)), np.nan) for _ in "pve"
        )
        for member, own in joints.items():
            its = beside(topic, joint_state_topic(member)) if member else topic
            at = [wanted.joints.index(name) for name in own.values()]
            if its in kept:
                for whole, part in zip((position, velocity, effort), kept[its], strict=True):
                    whole[:, at] = part
    bodies = []
    for body in wanted.bodies:
        pose, twist = kept[beside(topic, odometry_topic(body))]
        bodies.append(BodyMotion(body, with_steady_signs(pose), _absent_if_nan(twist)))
    fields = without_infinite(position), _absent_if_nan(without_infinite(velocity)), None
    return Motion(
        wanted.joints,
        stamps,
        *fields,
        _absent_if_nan(without_infinite(effort)),
        None,
        tuple(bodies),
    )


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
    kept = {}
    for topic, (stamps, order, _) in clocks.items():
        if len(common) < len(stamps):
            dropped[f"{topic}: no message of its stamp on the other topics"] += len(stamps) - len(
                common
            )
            order = order[np.isin(stamps, common)]
        fields = streams[topic].fields
        whole = len(order) == len(streams[topic].stamps)
        kept[topic] = fields if whole else tuple(field[order] for field in fields)
    return common, kept, by_log_time


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


def _absent_if_nan(values: Array) -> Array | None:
    return None if np.isnan(values).all() else values


def bag_wrenches(
    path: Path, names: Mapping[str, str | None], dropped: Counter[str]
) -> dict[str, WrenchSamples]:
    """See `recordings.read_wrenches`."""
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
