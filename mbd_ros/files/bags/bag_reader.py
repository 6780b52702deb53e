"""rosbag2 recordings, MCAP or sqlite3, read as folder or bare file.

`messages` and `raw_messages` give one message at a time, `raw_blocks` many messages of one topic.
"""

from __future__ import annotations

import itertools
import struct
from collections import Counter
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import apsw
import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.reader import YAMLError, zstd
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.serde import SerdeError

from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import BagFiles, check_source
from mbd_ros.files.bags.bag_types import TYPES, from_cdr, type_hash
from mbd_ros.files.bags.bag_unpacking import Allowance
from mbd_ros.files.bags.mcap_chunks import chunks_in_order, indexed, pieces_of, scanned

_ROWS = 4096  # messages of a block, where the file has none of its own
# What rosbags and the libraries below it raise on cut and on bit-flipped files, found by trial.
CORRUPT = (
    *(ReaderError, SerdeError, zstd.ZstdError, apsw.Error, YAMLError, yaml.YAMLError),
    *(struct.error, OSError, MemoryError, RuntimeError, LookupError, TypeError, ValueError),
    *(OverflowError, AttributeError, AssertionError),
)


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


class RawMessage(NamedTuple):
    """One message as it was recorded.

    Attributes:
        msgtype: As `sensor_msgs/msg/JointState`.
        log_time: When the recorder received it [ns].
        cdr: Serialised message with its encapsulation header.
    """

    topic: str
    msgtype: str
    log_time: int
    cdr: bytes


@contextmanager
def chosen(
    path: Path, topics: Mapping[str, str] | None
) -> Iterator[tuple[CountingReader, list[Any], Counter[str]]]:
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


class CountingReader(Reader):
    """A reader of rosbags that counts what it unpacks, and refuses more than an `Allowance`.

    Args:
        path: The bag.
        files: Those that it consists of.
    """

    def __init__(self, path: Path, files: BagFiles) -> None:
        super().__init__(path)
        self.allowance = Allowance(path, files.storage)
        self._packed = files.storage if files.is_packed else []

    def open(self) -> None:
        """Open the bag; what is compressed as a whole is unpacked."""
        for file in self._packed:
            self.allowance.count_file(file)
        with self.allowance.counting():
            super().open()

    def messages(
        self,
        connections: Collection[Any] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Any, int, bytes], None, None]:
        """Connection, log time and bytes of messages."""
        if self.compression_mode != "message":
            stream = super().messages(connections, start, stop)
            yield from self.allowance.counted(stream)
            return
        for storage in self.storage.storages:  # type: ignore[attr-defined]
            pairs = itertools.product(storage.connections, connections or self.connections)
            wanted = {own.id: known for own, known in pairs if _is_same(own, known)}
            own = [connection for connection in storage.connections if connection.id in wanted]
            stream = self.allowance.counted(storage.messages(own, start, stop)) if own else ()
            for connection, log_time, packed in stream:
                yield wanted[connection.id], log_time, self.allowance.message(packed)


@contextmanager
def _reading(path: Path) -> Iterator[CountingReader]:
    try:
        with CountingReader(path, check_source(path)) as reader:
            yield reader
    except CORRUPT as error:
        reason = f"{type(error).__name__}: {error}".rstrip(": ")
        raise DataError(f"{path}: truncated, corrupt or not readable ({reason})") from error


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


def _types(path: Path, reader: Reader) -> dict[str, str]:
    types: dict[str, str] = {}
    for c in reader.connections:
        if types.setdefault(c.topic, c.msgtype) != c.msgtype:
            raise DataError(
                f"{path}: topic {c.topic} has two types, {types[c.topic]} and {c.msgtype}"
            )
    return types


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


def topic_types(path: str | Path) -> dict[str, str]:
    """Message type of every topic.

    Raises:
        DataError: Not a readable bag, or a topic with two types.
    """
    with _reading(Path(path)) as reader:
        return _types(Path(path), reader)


def raw_blocks(path: Path, topic: str, msgtype: str) -> Iterator[RawBlock]:
    """Messages of a topic in log-time order.

    MCAP files are read chunk by chunk, with the index of messages behind each.

    Args:
        msgtype: Type that it must have.
    """
    with chosen(path, {topic: msgtype}) as (reader, connections, missing):
        for block in _blocks(reader, connections):
            missing[topic] -= len(block.log_times)
            yield block


class RawBlock(NamedTuple):
    """Messages as they were recorded, in log-time order.

    Attributes:
        log_times: When the recorder received them [ns], shape (n,), n > 0.
        data: Bytes that hold them.
        starts: Where each begins in `data`, shape (n,).
        sizes: Length of each, encapsulation included, shape (n,).
    """

    log_times: NDArray[np.int64]
    data: NDArray[np.uint8]
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]

    def rows(self) -> NDArray[np.uint8] | None:
        """One message a row, shape (n, size); None where they differ in length."""
        size = int(self.sizes[0])
        if size == 0 or (self.sizes != size).any():
            return None
        return pieces_of(self.data, self.starts, size)

    def messages(self) -> Iterator[tuple[int, bytes]]:
        """Log time and bytes of each."""
        content, ends = memoryview(self.data), (self.starts + self.sizes).tolist()
        for log_time, *place in zip(
            self.log_times.tolist(), self.starts.tolist(), ends, strict=True
        ):
            yield log_time, bytes(content[slice(*place)])


def _blocks(reader: CountingReader, connections: list[Any]) -> Iterator[RawBlock]:
    """Storage by storage where these follow each other in time."""
    storages = _storages(reader, connections)
    spans = [(one.metadata.start_time, one.metadata.end_time - 1) for one, _ in storages]
    pairs = itertools.pairwise(spans)
    if not storages or any(begin < end for (_, end), (begin, _) in pairs):
        stream = in_time_order(reader, connections)
        yield from _joined((log_time, cdr) for _, log_time, cdr in stream)
        return
    for storage, wanted in storages:
        if isinstance(storage, Sqlite3Reader):
            yield from _joined(_selected(storage, wanted))
            continue
        chunks = chunks_in_order(storage, wanted)
        if chunks is None:
            stream = reader.allowance.counted(storage.messages(wanted))
            yield from _joined((log_time, cdr) for _, log_time, cdr in stream)
        for chunk in chunks or ():
            with reader.allowance.counting():
                indexed_block = indexed(storage, chunk, wanted)
            if indexed_block is None:
                yield from _joined(reader.allowance.counted(scanned(storage, chunk, wanted)))
            else:
                yield RawBlock(*indexed_block)


def _storages(reader: Reader, connections: Sequence[Any]) -> list[tuple[Any, list[Any]]]:
    """Storages and their connections; none where each message is compressed by itself."""
    if reader.compression_mode == "message":
        return []
    storages = []
    for storage in getattr(reader.storage, "storages", [reader.storage]):
        selected = [x for x in storage.connections if any(_is_same(x, y) for y in connections)]
        if selected:
            storages.append((storage, selected))
    return storages


def _is_same(connection: Any, wanted: Any) -> bool:
    """Whether a connection of a storage is that of the bag, as rosbags tells them apart."""
    alike = (connection.topic, connection.msgtype, connection.ext) == (
        wanted.topic,
        wanted.msgtype,
        wanted.ext,
    )
    return alike and (
        not connection.digest or not wanted.digest or connection.digest == wanted.digest
    )


def _joined(stream: Iterable[tuple[int, bytes]]) -> Iterator[RawBlock]:
    """Blocks of messages that come one by one."""
    stream = iter(stream)
    while taken := list(itertools.islice(stream, _ROWS)):
        log_times, messages = zip(*taken, strict=True)
        sizes = np.fromiter(map(len, messages), np.int64, len(messages))
        data = np.frombuffer(b"".join(messages), np.uint8)
        yield RawBlock(np.array(log_times, np.int64), data, np.cumsum(sizes) - sizes, sizes)


def _selected(storage: Sqlite3Reader, connections: Sequence[Any]) -> Iterator[tuple[int, bytes]]:
    """Log time and bytes of messages of connections, as sqlite3 gives them."""
    assert storage.dbconn is not None
    ids = tuple({c.id for c in connections})
    places = ", ".join("?" * len(ids))
    rows: Iterator[tuple[int, bytes]] = storage.dbconn.execute(
        f"SELECT timestamp, data FROM messages WHERE topic_id IN ({places}) ORDER BY timestamp",
        ids,
    )
    return rows
