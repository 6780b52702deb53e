"""sensor_msgs/JointState as serialized bytes <-> arrays, for streams at high rates.

The layout of a JointState in CDR is fixed by its frame_id, its names and the lengths of its
arrays. While these stay, stamps and numbers are read and written in place; no message object is
made.

Layout after the 4 bytes of encapsulation, little endian: sec, nanosec, frame_id, number of names
and the names, then position, velocity and effort, each a count and, aligned to 8, its doubles. A
text is its length with the final NUL, its bytes and the NUL; counts are aligned to 4.

Source: OMG, DDS-XTypes 1.3, 7.4.3 (plain CDR); Interface definition of sensor_msgs/JointState.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from msg_adapters.finite import is_surely_finite, require_finite
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.time import seconds_of, stamp_of

LITTLE_ENDIAN = b"\x00\x01"
ENCAPSULATION = 4
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
FIELDS = ("position", "velocity", "effort")


class Layout(NamedTuple):
    """Places in one kind of message, as offsets after the encapsulation.

    Attributes:
        size: Length of the whole message.
        texts: Bytes of frame_id and names.
        counts: The three array lengths.
        marks: Offset and bytes of the first two; the third follows from the size.
        slices: Position, velocity and effort among the doubles that the whole body would be.
        doubles: Their number.
    """

    size: int
    texts: bytes
    counts: tuple[int, ...]
    marks: tuple[tuple[slice, bytes], ...]
    slices: tuple[slice, ...]
    doubles: int

    def fits(self, cdr: bytes, body: bytes) -> bool:
        """Whether a message has this layout."""
        if len(cdr) != self.size or not body.startswith(self.texts, _STAMP.size):
            return False
        (position, positions), (velocity, velocities) = self.marks
        lengths_fit = body[position] == positions and body[velocity] == velocities
        return lengths_fit and cdr.startswith(LITTLE_ENDIAN)


def layout_of(cdr: bytes) -> Layout:
    """Layout of a little-endian JointState."""
    body = cdr[ENCAPSULATION:]
    at = _after_text(body, _STAMP.size)
    (names,) = _COUNT.unpack_from(body, at)
    at += _COUNT.size
    for _ in range(names):
        at = _after_text(body, at)
    end_of_texts = at
    counts, marks, slices = [], [], []
    for _ in FIELDS:
        (count,) = _COUNT.unpack_from(body, at)
        counts.append(count)
        marks.append((slice(at, at + _COUNT.size), body[at : at + _COUNT.size]))
        at += _COUNT.size
        if count:
            at = _aligned(at, 8)
        slices.append(slice(at // 8, at // 8 + count))
        at += 8 * count
    texts = body[_STAMP.size : end_of_texts]
    arrays = tuple(counts), tuple(marks[:2]), tuple(slices)
    return Layout(len(cdr), texts, *arrays, len(body) // 8)


def _aligned(at: int, to: int) -> int:
    return -(-at // to) * to


def _after_text(body: bytes, at: int) -> int:
    return _aligned(at + _COUNT.size + _COUNT.unpack_from(body, at)[0], 4)


class JointStateCdrReader:
    """Reads serialized messages; a new layout is read once as message.

    Args:
        reader: Takes messages, and arranges the joints.
        deserialize: Message of its bytes.
    """

    def __init__(self, reader: JointStateReader, deserialize: Callable[[bytes], Any]) -> None:
        self._reader, self._deserialize = reader, deserialize
        self._layout: Layout | None = None
        self._is_arranged = False

    def read(self, cdr: bytes) -> JointSample:
        """Arrays of one message, as `JointStateReader.read`.

        Args:
            cdr: JointState with its encapsulation.

        Raises:
            MessageError: As `JointStateReader.read`.
        """
        body = cdr[ENCAPSULATION:]  # a copy whose doubles are aligned
        layout = self._layout
        if layout is None or not layout.fits(cdr, body):
            self._layout = None
            sample = self._reader.read(self._deserialize(cdr))
            if cdr.startswith(LITTLE_ENDIAN):
                self._layout = layout_of(cdr)
                self._is_arranged = self._reader.is_arranged(*self._layout.counts)
            return sample
        stamp = stamp_of(*_STAMP.unpack_from(body))
        doubles = np.frombuffer(body, np.float64, layout.doubles)
        position, velocity, effort = layout.slices
        if self._is_arranged:
            acted = doubles[effort] if self._reader.with_effort else self._reader.absent
            return JointSample(stamp, doubles[position], doubles[velocity], acted)
        return self._reader.arrange(stamp, doubles[position], doubles[velocity], doubles[effort])


class JointStateCdrWriter:
    """Refills one kept serialized message.

    Args:
        names: Joint or constraint names, in the order of the arrays.
        fields: Which of position, velocity and effort the message carries.
    """

    def __init__(self, names: Sequence[str], fields: Sequence[str] = FIELDS) -> None:
        message = encoded(names, [len(names) if field in fields else 0 for field in FIELDS])
        layout = layout_of(message)
        # So many bytes in front that the doubles are aligned in memory.
        self._buffer = bytearray(ENCAPSULATION) + message
        self._message = memoryview(self._buffer)[ENCAPSULATION:]
        doubles = np.frombuffer(self._buffer, np.float64, layout.doubles, 2 * ENCAPSULATION)
        self._views = {
            field: doubles[part]
            for field, part in zip(FIELDS, layout.slices, strict=True)
            if part.stop > part.start
        }
        used = [part for part in layout.slices if part.stop > part.start]
        # Counts stand in between: as doubles they are next to nothing, and finite.
        self._numbers = doubles[used[0].start : used[-1].stop] if used else doubles[:0]

    def write(self, stamp: int, **values: Any) -> bytes:
        """The message with new contents.

        Args:
            stamp: Header stamp [ns].
            **values: One array a field, in the order of the names.

        Raises:
            MessageError: A value is NaN or infinite, or no message can carry the stamp.
        """
        _STAMP.pack_into(self._buffer, 2 * ENCAPSULATION, *seconds_of(stamp))
        if self._views:
            for field, value in values.items():
                self._views[field][:] = value
            if not is_surely_finite(self._numbers):
                require_finite(**{field: self._views[field] for field in values})
        return bytes(self._message)


def encoded(names: Sequence[str], lengths: Sequence[int]) -> bytes:
    """A JointState of zeros, its position, velocity and effort of these lengths."""
    body = bytearray(_STAMP.size)
    _append_text(body, "")
    body += _COUNT.pack(len(names))
    for name in names:
        _append_text(body, name)
    for length in lengths:
        _pad(body, 4)
        body += _COUNT.pack(length)
        if length:
            _pad(body, 8)
            body += bytes(8 * length)
    return LITTLE_ENDIAN + bytes(2) + bytes(body)


def _append_text(body: bytearray, text: str) -> None:
    data = text.encode() + bytes(1)
    body += _COUNT.pack(len(data)) + data
    _pad(body, 4)


def _pad(body: bytearray, to: int) -> None:
    body += bytes(_aligned(len(body), to) - len(body))
