"""rosbag2 recordings, MCAP or sqlite3, read as folder or bare file."""

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import apsw
import yaml
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.reader import YAMLError, zstd
from rosbags.serde import SerdeError

from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import check_source
from mbd_ros.files.bags.bag_types import TYPES, from_cdr, new_message, type_hash
from mbd_ros.files.bags.bag_writer import BagWriter

__all__ = ["BagWriter", "RawMessage", "messages", "new_message", "raw_messages", "topic_types"]
# What rosbags and the libraries below it raise on cut and on bit-flipped files, found by trial.
CORRUPT = (
    *(ReaderError, SerdeError, zstd.ZstdError, apsw.Error, YAMLError, yaml.YAMLError),
    *(struct.error, OSError, MemoryError, RuntimeError, LookupError, TypeError, ValueError),
    *(OverflowError, AttributeError, AssertionError),
)


class RawMessage(NamedTuple):
    """One message as it was recorded.

    Attributes:
        topic: Topic name.
        msgtype: As `sensor_msgs/msg/JointState`.
        log_time: When the recorder received it [ns].
        cdr: Serialised message with its encapsulation header.
    """

    topic: str
    msgtype: str
    log_time: int
    cdr: bytes


def topic_types(path: str | Path) -> dict[str, str]:
    """Message type of every topic.

    Raises:
        DataError: Not a readable bag, or a topic with two types.
    """
    with _reading(Path(path)) as reader:
        return _types(Path(path), reader)


def messages(
    path: str | Path, topics: Mapping[str, str] | None = None
) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time [ns] and message, in log-time order.

    Args:
        path: Bag folder, .mcap or .db3 file.
        topics: Wanted topics, each with the type it must have; all without it.

    Raises:
        DataError: As `raw_messages`, or a message that cannot be taken apart.
    """
    for raw in raw_messages(path, topics):
        try:
            message = from_cdr(raw.cdr, raw.msgtype)
        except (DataError, *CORRUPT) as error:
            raise DataError(f"{path}: topic {raw.topic}: unreadable message ({error})") from error
        yield raw.topic, raw.log_time, message


def raw_messages(
    path: str | Path, topics: Mapping[str, str] | None = None
) -> Iterator[RawMessage]:
    """Messages as recorded, in log-time order.

    Raises:
        DataError: Unknown topic, wrong type, no messages, or a truncated, corrupt or hostile bag;
            after the last message where some that the bag promises are not in it.
    """
    with chosen(Path(path), topics) as (reader, connections, missing):
        for connection, log_time, cdr in in_time_order(reader, connections):
            missing[connection.topic] -= 1
            yield RawMessage(
                connection.topic, connection.msgtype, int(log_time), bytes(memoryview(cdr))
            )


@contextmanager
def chosen(
    path: Path, topics: Mapping[str, str] | None
) -> Iterator[tuple[Reader, list[Any], Counter[str]]]:
    """Reader, connections of the wanted topics, and the number of their messages by topic.

    Whoever reads messages takes them off these numbers.

    Raises:
        DataError: As `raw_messages`, on entering or at the end of the block.
    """
    with _reading(path) as reader:
        _check_topics(path, _types(path, reader), topics)
        connections = [c for c in reader.connections if topics is None or c.topic in topics]
        missing: Counter[str] = Counter()
        for connection in connections:
            _check_definition(path, connection)
            missing[connection.topic] += connection.msgcount
        empty = [topic for topic in topics or () if not missing[topic]]
        if empty or not any(missing.values()):
            raise DataError(f"{path}: no messages on {', '.join(empty) or 'any topic'}")
        yield reader, connections, missing
        if lost := {topic: count for topic, count in missing.items() if count}:
            raise DataError(f"{path}: truncated or corrupt, messages lost by topic: {lost}")


@contextmanager
def _reading(path: Path) -> Iterator[Reader]:
    try:
        check_source(path)
        with Reader(path) as reader:
            yield reader
    except CORRUPT as error:
        reason = f"{type(error).__name__}: {error}".rstrip(": ")
        raise DataError(f"{path}: truncated, corrupt or not readable ({reason})") from error


def _types(path: Path, reader: Reader) -> dict[str, str]:
    types: dict[str, str] = {}
    for c in reader.connections:
        if types.setdefault(c.topic, c.msgtype) != c.msgtype:
            raise DataError(
                f"{path}: topic {c.topic} has two types, {types[c.topic]} and {c.msgtype}"
            )
    return types


def _check_topics(path: Path, types: dict[str, str], topics: Mapping[str, str] | None) -> None:
    for topic, msgtype in (topics or {}).items():
        if topic not in types:
            from mbd_ros.scene.schema.renamed import renamed  # here, since it serves errors only

            there = ", ".join(f"{name} ({types[name]})" for name in sorted(types)) or "none"
            raise DataError(
                f"{path}: no topic {topic}{renamed('topic', topic)}; there are: {there}"
            )
        if types[topic] != msgtype:
            raise DataError(f"{path}: topic {topic} has type {types[topic]}, expected {msgtype}")


def _check_definition(path: Path, c: Any) -> None:
    if c.digest and c.msgtype in TYPES.fielddefs and c.digest != type_hash(c.msgtype):
        raise DataError(
            f"{path}: topic {c.topic}: {c.msgtype} was recorded with another definition than"
            f" that of ROS 2 Jazzy (hash {c.digest})"
        )


def in_time_order(reader: Reader, connections: list[Any]) -> Iterator[tuple[Any, int, bytes]]:
    """Each file comes in time order; the messages of several files are sorted in memory."""
    stream = reader.messages(connections)
    if len(getattr(reader.storage, "storages", ())) > 1:
        return iter(sorted(stream, key=lambda message: message[1]))
    return stream
