"""Many messages of several topics, written to the storage of a bag at once."""

import itertools
import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from mbd_ros.files.bags.mcap_chunks import MESSAGE, MESSAGE_INDEX, RECORD, put_pieces

_CHUNK = 2**20  # bytes after which rosbags ends a chunk
_NEVER = 2**63 - 1
_INSERTED = 32  # messages a statement of sqlite3, which costs more than a message


class Rows(NamedTuple):
    """Messages of a topic that are equally long.

    Attributes:
        topic: Its name.
        msgtype: As `sensor_msgs/msg/JointState`.
        log_times: [ns], shape (n,).
        cdr: Serialized messages with their encapsulation, one a row, shape (n, size).
    """

    topic: str
    msgtype: str
    log_times: NDArray[np.int64]
    cdr: NDArray[np.uint8]


def append(storage: Any, parts: Sequence[Rows], channels: Sequence[int]) -> None:
    """Write messages in the order of their log times, those of one time in the order of parts.

    Args:
        storage: Writer of rosbags, MCAP without compression or sqlite3.
        parts: The messages.
        channels: Number of the connection of each part.
    """
    times = np.concatenate([part.log_times for part in parts])
    order = np.argsort(times, kind="stable")
    if isinstance(storage, Sqlite3Writer):
        _insert(storage, parts, channels, order)
    else:
        _append(storage, parts, channels, order)


def _insert(
    storage: Sqlite3Writer, parts: Sequence[Rows], channels: Sequence[int], order: NDArray[np.intp]
) -> None:
    rows: list[tuple[int, int, bytes]] = []
    for part, channel in zip(parts, channels, strict=True):
        times, whole, size = part.log_times.tolist(), part.cdr.tobytes(), part.cdr.shape[1]
        begins = range(0, len(whole), size)
        rows += [(channel, t, whole[i : i + size]) for t, i in zip(times, begins, strict=True)]
    numbers = list(itertools.chain.from_iterable([rows[i] for i in order.tolist()]))
    several = len(rows) // _INSERTED * _INSERTED
    for begin, end, count in ((0, several, _INSERTED), (several, len(rows), 1)):
        places = [slice(3 * i, 3 * (i + count)) for i in range(begin, end, count)]
        storage.cursor.executemany(
            f"INSERT INTO messages (topic_id, timestamp, data) VALUES {_values(count)}",
            [numbers[place] for place in places],
        )


def _values(count: int) -> str:
    """Places of the numbers of so many messages in a statement."""
    return ", ".join(["(?, ?, ?)"] * count)


def _append(
    storage: McapWriter, parts: Sequence[Rows], channels: Sequence[int], order: NDArray[np.intp]
) -> None:
    """Chunks of about the length that rosbags gives them; what it has pending goes first."""
    sizes = [part.cdr.shape[1] + RECORD.itemsize for part in parts]
    counts = [len(part.log_times) for part in parts]
    in_order = np.repeat(np.array(sizes, np.int64), counts)[order]
    pending = storage.chunk.bio.getvalue()
    places = np.empty(len(order), np.int64)  # of the messages, part by part
    ends = len(pending) + np.cumsum(in_order)
    places[order] = ends - in_order
    data = np.empty(int(ends[-1]), np.uint8)
    data[: len(pending)] = np.frombuffer(pending, np.uint8)
    each = np.split(places, np.cumsum(counts)[:-1])
    for part, channel, at in zip(parts, channels, each, strict=True):
        heads = np.zeros(len(at), RECORD)
        heads["opcode"], heads["channel"] = MESSAGE, channel
        heads["length"] = part.cdr.shape[1] + RECORD.itemsize - 9
        heads["log_time"] = heads["publish_time"] = part.log_times
        put_pieces(data, at, heads.view(np.uint8).reshape(len(at), -1))
        put_pieces(data, at + RECORD.itemsize, part.cdr)
    index: dict[int, list[Any]] = {c: [found] for c, found in storage.chunk.msgs.items()}
    for part, channel, at in zip(parts, channels, each, strict=True):
        by_place = np.argsort(at, kind="stable")
        own = np.stack((part.log_times[by_place], at[by_place]), axis=1)
        index.setdefault(channel, []).append(own)
    entries = {channel: np.concatenate(found) for channel, found in index.items()}
    for begin, end in itertools.pairwise(_ends_of_chunks(ends)):
        _write_chunk(storage, data[begin:end], list(_within(entries, begin, end)))
    for channel, part in zip(channels, parts, strict=True):
        storage.channel_stats[channel] += len(part.log_times)
        span = int(part.log_times.min(initial=_NEVER)), int(part.log_times.max(initial=0))
        storage.message_start_time = min(storage.message_start_time, span[0])
        storage.message_end_time = max(storage.message_end_time, span[1])
    storage.chunk = PendingChunk(_NEVER, 0, BytesIO(), defaultdict(list))


def _ends_of_chunks(ends: NDArray[np.int64]) -> list[int]:
    """0, and where chunks end that begin there, of messages that end at these places."""
    found = [0]
    while found[-1] < ends[-1]:
        last = np.searchsorted(ends, found[-1] + _CHUNK, side="right")
        found.append(int(ends[min(last, len(ends) - 1)]))
    return found


def _within(
    index: Mapping[int, NDArray[np.int64]], begin: int, end: int
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Channels and entries of the messages of a chunk."""
    for channel, entries in index.items():
        first, last = np.searchsorted(entries[:, 1], (begin, end))
        if last > first:
            yield channel, entries[first:last] - (0, begin)


def _write_chunk(
    storage: McapWriter, data: NDArray[np.uint8], index: Sequence[tuple[int, NDArray[np.int64]]]
) -> None:
    """Write a chunk and the indices of its messages, as `McapWriter.close_chunk`."""
    bio, begin = storage.bio, storage.bio.tell()
    times = np.concatenate([entries[:, 0] for _, entries in index])
    span = struct.pack("<QQ", int(times.min()), int(times.max()))
    packing = struct.pack("<I", 0)  # no compression
    size = struct.pack("<Q", len(data))
    head = span + size + struct.pack("<I", 0) + packing + size
    bio.write(struct.pack("<BQ", 0x06, len(head) + len(data)) + head)
    bio.write(data.data)
    end, offsets = bio.tell(), b""
    for channel, entries in index:
        offsets += struct.pack("<HQ", channel, bio.tell())
        content = entries.astype("<u8").tobytes()
        own = struct.pack("<HI", channel, len(content)) + content
        bio.write(struct.pack("<BQ", MESSAGE_INDEX, len(own)) + own)
    about = BytesIO()
    about.write(span + struct.pack("<QQI", begin, end - begin, len(offsets)) + offsets)
    about.write(struct.pack("<Q", bio.tell() - end) + packing + size + size)
    storage.chunks.append(about)
