"""Joint states and wrenches out of bags."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.bags import messages
from mbd_ros.files.recording import Recording
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.wrench import WrenchSample, read_wrench

JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"


def bag_motion(path: Path, joints: Sequence[str], topic: str, needed: Sequence[str]) -> Recording:
    """See `recordings.read_motion`; `needed` joints must have a finite position."""
    dropped = Counter[str]()
    samples = _joint_samples(path, joints, topic, needed, dropped)
    stamps, kept, by_log_time = _clock(samples, dropped)
    motion = Motion(
        tuple(joints),
        stamps,
        _finite([samples[i][1].position for i in kept]),
        _absent_if_nan(_finite([samples[i][1].velocity for i in kept])),
        None,
        _absent_if_nan(_finite([samples[i][1].effort for i in kept])),
    )
    return Recording(motion, dropped, by_log_time)


def _joint_samples(
    path: Path,
    joints: Sequence[str],
    topic: str,
    needed: Sequence[str],
    dropped: Counter[str],
) -> list[tuple[int, JointSample]]:
    """Log time [ns] and sample of each message that can be used."""
    reader = JointStateReader(joints)
    used = [reader.names.index(name) for name in needed]
    samples, seen = [], set[str]()
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
    samples: Sequence[tuple[int, JointSample | WrenchSample]], dropped: Counter[str]
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
    samples: dict[str, list[tuple[int, WrenchSample]]] = {topic: [] for topic in topics.values()}
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
    path: Path, topic: str, samples: list[tuple[int, WrenchSample]], dropped: Counter[str]
) -> WrenchSamples:
    _check_any(path, topic, samples, dropped)
    frames = sorted({sample.frame_id for _, sample in samples})
    if len(frames) > 1:
        raise DataError(f"{path}: topic {topic}: frame_id changes between {', '.join(frames)}")
    stamps, kept, _ = _clock(samples, dropped)
    return WrenchSamples(stamps, np.array([samples[i][1].wrench for i in kept]), frames[0])
