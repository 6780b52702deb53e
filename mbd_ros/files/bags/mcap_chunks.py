"""Chunks of MCAP files, each unpacked as a whole, with the index of messages behind it.

A message in a chunk is a record: opcode 5, length of the rest (8 bytes), channel (2), sequence
(4), log time (8), publish time (8), then the message. The index of a channel is a record of
opcode 7: length (8), channel (2), bytes of the entries (4), then entries of log time (8) and
place in the unpacked chunk (8). All are little endian.

Source: MCAP specification, version 0, sections Message (0x05), Chunk (0x06), Message Index (0x07).
"""

import itertools
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, decompress, msgsrc

MESSAGE, CHUNK, MESSAGE_INDEX = 0x05, 0x06, 0x07  # opcodes
RECORD = np.dtype(
    [
        *(("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")),
        *(("log_time", "<u8"), ("publish_time", "<u8")),
    ]
)
FRAME = 9  # bytes of opcode and length, which a length does not count
_CHECKSUM, _PACKED = 24, 40  # places in a chunk record of its checksum, and of what it holds
_INDEX = struct.Struct("<BQHI")
Found = tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]]


def chunks_in_order(storage: Any, connections: Sequence[Any]) -> list[ChunkInfo] | None:
    """Chunks with messages of connections; None where they overlap in time, or have no index."""
    if not isinstance(storage, McapReader) or not storage.chunks:
        return None
    chunks = [
        chunk
        for chunk in storage.chunks
        if any(chunk.channel_count.get(c.id) for c in connections)
    ]
    for one, after in itertools.pairwise(chunks):
        if after.message_start_time < one.message_end_time:
            return None
        if after.chunk_start_offset < one.chunk_start_offset:
            return None
    return chunks


def indexed(storage: McapReader, chunk: ChunkInfo, connections: Sequence[Any]) -> Found | None:
    """Messages of connections in a chunk, in log-time order: the fields of a `RawBlock`.

    None where its index is not that of what it holds.
    """
    data = np.frombuffer(_unpacked(storage, chunk), np.uint8)
    tables = [_entries(storage, chunk, c.id) for c in connections]
    entries = np.concatenate([table for table in tables if table is not None])
    entries = entries[np.lexsort((entries[:, 1], entries[:, 0]))]
    times, at = entries.astype(np.int64).T
    lacking = not len(at) or any(table is None for table in tables)
    if lacking or at.min() < 0 or at.max() > len(data) - RECORD.itemsize:
        return None
    heads = pieces_of(data, at, RECORD.itemsize).view(RECORD)[:, 0]
    sizes = heads["length"].astype(np.int64) + FRAME - RECORD.itemsize
    starts = at + RECORD.itemsize
    is_known = np.isin(heads["channel"], [c.id for c in connections])
    fits = (heads["opcode"] == MESSAGE) & is_known & (heads["log_time"] == entries[:, 0])
    fits &= (sizes >= 0) & (sizes <= len(data) - starts)
    in_time = chunk.message_start_time <= times[0] and times[-1] <= chunk.message_end_time
    if not (fits.all() and in_time and np.diff(np.sort(at)).all()):
        return None
    return times, data, starts, sizes


def scanned(
    storage: McapReader, chunk: ChunkInfo, connections: Sequence[Any]
) -> Iterator[tuple[int, bytes]]:
    """Log time and bytes of messages of connections in a chunk, found record by record."""
    span = chunk.message_start_time, chunk.message_end_time + 1
    assert storage.bio is not None
    for message in msgsrc(chunk, {c.id: c for c in connections}, *span, storage.bio):
        if message.data is not None:
            yield message.timestamp, message.data


def pieces_of(data: NDArray[np.uint8], starts: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    """Copies of pieces of one length that lie inside of `data`, shape (len(starts), size)."""
    every: NDArray[np.void] = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return every[starts].view(np.uint8).reshape(len(starts), size)


def put_pieces(
    data: NDArray[np.uint8], starts: NDArray[np.int64], pieces: NDArray[np.uint8]
) -> None:
    """Copy pieces of one length, one a row, to their places in `data`."""
    size = pieces.shape[1]
    every: NDArray[np.void] = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    every[starts] = np.ascontiguousarray(pieces).view(f"V{size}")[:, 0]


def _unpacked(storage: McapReader, chunk: ChunkInfo) -> bytes:
    """Return the content of a chunk after a check of its checksum."""
    begin = chunk.chunk_start_offset + FRAME
    (checksum,) = struct.unpack("<I", _read(storage, begin + _CHECKSUM, 4))
    packed = _read(storage, begin + _PACKED + len(chunk.compression), chunk.compressed_size)
    return decompress(packed, chunk.compression, chunk.uncompressed_size, checksum)


def _entries(storage: McapReader, chunk: ChunkInfo, channel: int) -> NDArray[np.uint64] | None:
    """Log times and places of the messages of a channel, shape (n, 2); None for no index."""
    if channel not in chunk.message_index_offsets:
        return np.zeros((0, 2), np.uint64)
    place = chunk.message_index_offsets[channel]
    opcode, _, owner, size = _INDEX.unpack(_read(storage, place, _INDEX.size))
    if opcode != MESSAGE_INDEX or owner != channel or size != 16 * chunk.channel_count[channel]:
        return None
    return np.frombuffer(_read(storage, place + _INDEX.size, size), "<u8").reshape(-1, 2)


def _read(storage: McapReader, place: int, size: int) -> bytes:
    assert storage.bio is not None
    storage.bio.seek(place)
    found = storage.bio.read(size)
    if len(found) != size:
        raise struct.error(f"{size} bytes at {place} end after {len(found)}")
    return found
