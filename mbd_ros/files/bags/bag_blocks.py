"""Messages of one topic of a bag, many at once."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from mbd_ros.files.bags.bags import chosen, in_time_order
from mbd_ros.files.bags.mcap_chunks import chunks_in_order, indexed, pieces_of, scanned

_ROWS = 4096  # messages of a block, where the file has none of its own


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
        whole, ends = memoryview(self.data), (self.starts + self.sizes).tolist()
        for log_time, *place in zip(
            self.log_times.tolist(), self.starts.tolist(), ends, strict=True
        ):
            yield log_time, bytes(whole[slice(*place)])


def raw_blocks(path: Path, topic: str, msgtype: str) -> Iterator[RawBlock]:
    """Messages of a topic in log-time order.

    MCAP files are read chunk by chunk, with the index of messages behind each.

    Args:
        path: The bag.
        topic: The topic.
        msgtype: Type that it must have.

    Raises:
        DataError: As `bags.raw_messages`.
    """
    with chosen(path, {topic: msgtype}) as (reader, connections, missing):
        for block in _blocks(reader, connections):
            missing[topic] -= len(block.log_times)
            yield block


def _blocks(reader: Reader, connections: list[Any]) -> Iterator[RawBlock]:
    """Storage by storage where these follow each other in time."""
    storages = _storages(reader, connections)
    spans = [(one.metadata.start_time, one.metadata.end_time - 1) for one, _ in storages]
    pairs = itertools.pairwise(spans)
    if not storages or any(begin < end for (_, end), (begin, _) in pairs):
        stream = in_time_order(reader, connections)
        yield from _joined((log_time, cdr) for _, log_time, cdr in stream)
        return
    for storage, own in storages:
        if isinstance(storage, Sqlite3Reader):
            yield from _joined(_selected(storage, own))
            continue
        chunks = chunks_in_order(storage, own)
        if chunks is None:
            stream = storage.messages(own)
            yield from _joined((log_time, cdr) for _, log_time, cdr in stream)
        for chunk in chunks or ():
            found = indexed(storage, chunk, own)
            if found is None:
                yield from _joined(scanned(storage, chunk, own))
            else:
                yield RawBlock(*found)


def _storages(reader: Reader, connections: Sequence[Any]) -> list[tuple[Any, list[Any]]]:
    """Storages and their connections; none where each message is compressed by itself."""
    if reader.compression_mode == "message":
        return []
    found = []
    for storage in getattr(reader.storage, "storages", [reader.storage]):
        own = [x for x in storage.connections if any(_is_same(x, y) for y in connections)]
        if own:
            found.append((storage, own))
    return found


def _is_same(own: Any, wanted: Any) -> bool:
    """Whether a connection of a storage is that of the bag, as rosbags tells them apart."""
    alike = (own.topic, own.msgtype, own.ext) == (wanted.topic, wanted.msgtype, wanted.ext)
    return alike and (not own.digest or not wanted.digest or own.digest == wanted.digest)


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


def _joined(stream: Iterable[tuple[int, bytes]]) -> Iterator[RawBlock]:
    """Blocks of messages that come one by one."""
    stream = iter(stream)
    while taken := list(itertools.islice(stream, _ROWS)):
        log_times, messages = zip(*taken, strict=True)
        sizes = np.fromiter(map(len, messages), np.int64, len(messages))
        data = np.frombuffer(b"".join(messages), np.uint8)
        yield RawBlock(np.array(log_times, np.int64), data, np.cumsum(sizes) - sizes, sizes)
