"""rosbag2 recordings written whole or not at all, one message or many of several topics at once.

Many at once go past the writer of rosbags to its storage: MCAP chunks with the index of messages
behind each (see `mcap_chunks`), or rows of sqlite3.
"""

from __future__ import annotations

import itertools
import os
import shutil
import sqlite3
import struct
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import MARK, check_target
from mbd_ros.files.bags.bag_types import TYPES, to_cdr
from mbd_ros.files.bags.mcap_chunks import CHUNK, FRAME, MESSAGE, MESSAGE_INDEX, RECORD, put_pieces

_CHUNK_BYTES = 2**20  # bytes after which rosbags ends a chunk
_NEVER = 2**63 - 1
_INSERTED = 32  # messages a statement of sqlite3, which costs more than a message
_SHOWN = 40  # characters of a name in that of a temporary folder: names end at 255 bytes
PLUGINS = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}
_IN_MEMORY = 2**24  # bytes that need no file


@final
class BagWriter:
    """Writes a bag beside its place and puts it there when the `with` block ends well.

    Args:
        path: A folder (MCAP storage), or a file ending in .mcap or .db3. An existing
            bag is replaced only if this class wrote it.

    Raises:
        DataError: On entering for a place that cannot be written to; later, when writing fails.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(os.path.abspath(path))
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> BagWriter:
        with self._failing():
            check_target(self.path)
            self._room = Path(
                tempfile.mkdtemp(prefix=f".{self.path.name[:_SHOWN]}.", dir=self.path.parent)
            )
            with ExitStack() as undo:
                undo.callback(shutil.rmtree, self._room, ignore_errors=True)
                self._open()
                undo.pop_all()
        return self

    def _open(self) -> None:
        bare = self.path.suffix in PLUGINS and not self.path.is_dir()
        # rosbags names the storage file after its folder.
        folder = self._room / "new" / ("bag" if bare else self.path.name)
        self._product = folder / f"bag{self.path.suffix}" if bare else folder
        plugin = PLUGINS[self.path.suffix if bare else ".mcap"]
        self._writer = Writer(folder, version=9, storage_plugin=plugin)
        self._writer.set_custom_data(*MARK)
        self._writer.open()

    def write(self, topic: str, msgtype: str, log_time: int, message: Any) -> None:
        """Append one message.

        Args:
            topic: Topic name; one type a topic.
            msgtype: As `sensor_msgs/msg/JointState`.
            log_time: [ns], >= 0.
            message: Message of rosbags (see `new_message`), or its CDR as bytes.
        """
        if msgtype not in TYPES.fielddefs:
            raise DataError(f"{self.path}: topic {topic}: {msgtype} is no type of ROS 2 Jazzy")
        if not 0 <= log_time < 2**63:
            raise DataError(f"{self.path}: topic {topic}: {log_time} ns is no time for a bag")
        with self._failing():
            cdr = message if isinstance(message, bytes) else to_cdr(message, msgtype)
            self._writer.write(self._connection(topic, msgtype), log_time, cdr)

    def write_rows(self, parts: Sequence[Rows]) -> None:
        """Append messages of several topics, in the order of their log times.

        Args:
            parts: The messages; those of one time come in the order of the parts.
        """
        parts = [part for part in parts if len(part.log_times)]
        for part in parts:
            earliest = int(part.log_times.min())
            if earliest < 0:
                where = f"{self.path}: topic {part.topic}"
                raise DataError(f"{where}: {earliest} ns is no time for a bag")
        with self._failing():
            known = [self._connection(part.topic, part.msgtype) for part in parts]
            if not parts:
                return
            append_rows(self._writer.storage, parts, [connection.id for connection in known])
            for part, connection in zip(parts, known, strict=True):
                times, writer = part.log_times, self._writer
                writer.counts[connection.id] += len(times)
                writer.min_timestamp = min(writer.min_timestamp, int(times.min()))
                writer.max_timestamp = max(writer.max_timestamp, int(times.max()))

    def _connection(self, topic: str, msgtype: str) -> Connection:
        if topic not in self._connections:
            add = self._writer.add_connection
            self._connections[topic] = add(topic, msgtype, typestore=TYPES)
        known = self._connections[topic]
        if known.msgtype != msgtype:
            raise DataError(f"{self.path}: topic {topic} has type {known.msgtype}, not {msgtype}")
        return known

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with self._failing():
                self._writer.__exit__(kind, error, trace)
                if kind is None:
                    self._publish()
        finally:
            shutil.rmtree(self._room, ignore_errors=True)

    def _publish(self) -> None:
        old = self._room / "old"
        if self.path.is_dir():
            os.rename(self.path, old)
        try:
            os.replace(self._product, self.path)
        except OSError:
            if old.exists():
                os.rename(old, self.path)
            raise

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except (WriterError, OSError, sqlite3.Error, struct.error) as error:
            raise DataError(f"{self.path}: cannot be written ({error})") from error


class Rows(NamedTuple):
    """Messages of a topic that are equally long.

    Attributes:
        msgtype: As `sensor_msgs/msg/JointState`.
        log_times: [ns], shape (n,).
        cdr: Serialized messages with their encapsulation, one a row, shape (n, size).
    """

    topic: str
    msgtype: str
    log_times: NDArray[np.int64]
    cdr: NDArray[np.uint8]


def append_rows(storage: Any, parts: Sequence[Rows], channels: Sequence[int]) -> None:
    """Write messages in the order of their log times, those of one time in the order of parts.

    Args:
        storage: Writer of rosbags, MCAP without compression or sqlite3.
        channels: Number of the connection of each part.
    """
    times = np.concatenate([part.log_times for part in parts])
    order = np.argsort(times, kind="stable")
    if isinstance(storage, Sqlite3Writer):
        _insert_rows(storage, parts, channels, order)
    else:
        _append_chunks(storage, parts, channels, order)


def _insert_rows(
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
        values = ", ".join(["(?, ?, ?)"] * count)
        storage.cursor.executemany(
            f"INSERT INTO messages (topic_id, timestamp, data) VALUES {values}",
            [numbers[place] for place in places],
        )


def _append_chunks(
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
        heads["length"] = part.cdr.shape[1] + RECORD.itemsize - FRAME
        heads["log_time"] = heads["publish_time"] = part.log_times
        put_pieces(data, at, heads.view(np.uint8).reshape(len(at), -1))
        put_pieces(data, at + RECORD.itemsize, part.cdr)
    index: dict[int, list[Any]] = {c: [entry] for c, entry in storage.chunk.msgs.items()}
    for part, channel, at in zip(parts, channels, each, strict=True):
        by_place = np.argsort(at, kind="stable")
        own = np.stack((part.log_times[by_place], at[by_place]), axis=1)
        index.setdefault(channel, []).append(own)
    entries = {channel: np.concatenate(entry) for channel, entry in index.items()}
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
    chunk_ends = [0]
    while chunk_ends[-1] < ends[-1]:
        last = np.searchsorted(ends, chunk_ends[-1] + _CHUNK_BYTES, side="right")
        chunk_ends.append(int(ends[min(last, len(ends) - 1)]))
    return chunk_ends


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
    bio.write(struct.pack("<BQ", CHUNK, len(head) + len(data)) + head)
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


def _within(
    index: Mapping[int, NDArray[np.int64]], begin: int, end: int
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Channels and entries of the messages of a chunk."""
    for channel, entries in index.items():
        first, last = np.searchsorted(entries[:, 1], (begin, end))
        if last > first:
            yield channel, entries[first:last] - (0, begin)


class Spool:
    """Rows that wait in memory while they are few, else in a file without a name.

    Args:
        folder: Where there is room.
        width: Numbers in a row.
        kind: Of the numbers.

    Attributes:
        rows: How many there are.

    Raises:
        DataError: The folder has no room.
    """

    def __init__(self, folder: Path, width: int, kind: type[np.generic] = np.float64) -> None:
        self._folder, self.width, self._kind, self.rows = folder, width, np.dtype(kind), 0
        self._newest: list[NDArray[Any]] = []
        self._filed = 0  # rows in the file
        with self._failing():
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 closed on leaving

    def append(self, values: NDArray[Any]) -> None:
        """Add rows, shape (n, width) or, of one number each, (n,); they must stay as they are."""
        self._newest.append(np.asarray(values, self._kind).reshape(-1, self.width))
        self.rows += len(values)
        if (self.rows - self._filed) * self.width * self._kind.itemsize > _IN_MEMORY:
            with self._failing():
                self._file.seek(0, 2)
                for rows in self._newest:
                    self._file.write(np.ascontiguousarray(rows).data)
            self._newest, self._filed = [], self.rows

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Some rows that follow each other, shape (n, width); not to be written to."""
        begin, end, _ = rows.indices(self.rows)
        pieces = [self._from_file(begin, min(end, self._filed))] if begin < self._filed else []
        first = self._filed
        for piece in self._newest:
            own = piece[max(begin - first, 0) : max(end - first, 0)]
            pieces += [own] if len(own) else []
            first += len(piece)
        nothing = np.zeros((0, self.width), self._kind)
        return pieces[0] if len(pieces) == 1 else np.concatenate([nothing, *pieces])

    def _from_file(self, begin: int, end: int) -> NDArray[Any]:
        size = self._kind.itemsize * self.width
        with self._failing():
            self._file.seek(size * begin)
            data = self._file.read(size * max(end - begin, 0))
        return np.frombuffer(data, self._kind).reshape(-1, self.width)

    def __enter__(self) -> Spool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._failing():
            self._file.close()

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise DataError(
                f"{self._folder}: no room for what has to wait ({error.strerror})"
            ) from error


class StampSpool:
    """Stamps [ns] in a spool of one number a row.

    Args:
        spool: The numbers, of the kind int64.
    """

    def __init__(self, spool: Spool) -> None:
        self._spool = spool

    def append(self, stamps: NDArray[np.int64]) -> None:
        """Add some, shape (n,)."""
        self._spool.append(stamps)

    def __len__(self) -> int:
        return self._spool.rows

    def __getitem__(self, rows: slice) -> NDArray[np.int64]:
        """Some that follow each other, shape (n,)."""
        return self._spool[rows][:, 0]
