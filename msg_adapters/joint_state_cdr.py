"""sensor_msgs/JointState as serialized bytes <-> arrays, for streams at high rates and bags.

The layout of a JointState in CDR is fixed by its frame_id, its names and the lengths of its
arrays. While these stay, stamps and numbers are read and written in place, of one message or of
many with one layout at once; no message object is made.

Layout after the 4 bytes of encapsulation, little endian: sec, nanosec, frame_id, number of names
and the names, then position, velocity and effort, each a count and, aligned to 8, its doubles.

Source: `cdr`; interface definition of sensor_msgs/JointState.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.cdr import (
    COUNT,
    ENCAPSULATION,
    HEAD,
    LITTLE_ENDIAN,
    STAMP,
    after_text,
    aligned,
    encoded_text,
    refilled,
)
from msg_adapters.errors import MessageError, is_surely_finite, require_finite
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.time import NANOSECONDS, seconds_of, stamp_of

FIELDS = ("position", "velocity", "effort")


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
        stamp = stamp_of(*STAMP.unpack_from(body))
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
        STAMP.pack_into(self._buffer, 2 * ENCAPSULATION, *seconds_of(stamp))
        if self._views:
            for field, value in values.items():
                self._views[field][:] = value
            if not is_surely_finite(self._numbers):
                require_finite(**{field: self._views[field] for field in values})
        return bytes(self._message)


class JointStateRowsReader:
    """Reads serialized messages of equal length, one a row of bytes.

    Args:
        reader: Takes the first message of a layout, and arranges the joints.
        deserialize: Message of its bytes.
    """

    def __init__(self, reader: JointStateReader, deserialize: Callable[[bytes], Any]) -> None:
        self._reader, self._deserialize = reader, deserialize

    def read(self, rows: NDArray[np.uint8]) -> JointRows | None:
        """Arrays of the messages; None where they have to be read one by one.

        That is so where one is malformed, big endian, or has another layout than the first: other
        names, another frame_id, or arrays of other lengths.

        Args:
            rows: JointStates with their encapsulation, shape (n, size), n > 0.
        """
        first = rows[0].tobytes()
        if not first.startswith(LITTLE_ENDIAN):
            return None
        try:
            self._reader.read(self._deserialize(first))
            layout = layout_of(first)
            if not _is_one(rows, layout):
                return None
            return self._arranged(rows, layout)
        except MessageError:
            return None

    def _arranged(self, rows: NDArray[np.uint8], layout: Layout) -> JointRows | None:
        body = rows[:, ENCAPSULATION:]
        stamps = np.ascontiguousarray(body[:, : STAMP.size])
        seconds = stamps.view("<i4")[:, 0].astype(np.int64)
        rest = stamps.view("<u4")[:, 1].astype(np.int64)
        if (rest >= NANOSECONDS).any():
            return None
        values = []
        for name, part in zip(FIELDS, layout.slices, strict=True):
            field = body[:, 8 * part.start : 8 * part.stop]
            doubles = np.ascontiguousarray(field).view("<f8")
            values.append(self._reader.picked(doubles, name))
        return JointRows(seconds * NANOSECONDS + rest, *values)


class JointRows(NamedTuple):
    """Many JointStates in the order of the reader's names; NaN stands for absent.

    Attributes:
        stamps: Header stamps [ns]; 0 where the publisher set none, shape (n,).
        position: [rad or m], shape (n, m).
        velocity: [rad/s or m/s], shape (n, m).
        effort: [N·m or N], shape (n, m).
    """

    stamps: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    effort: NDArray[np.float64]


def _is_one(rows: NDArray[np.uint8], layout: Layout) -> bool:
    """Whether all have the encapsulation, the texts and the array lengths of the first."""
    begin = ENCAPSULATION + STAMP.size
    places = [slice(0, len(LITTLE_ENDIAN)), slice(begin, begin + len(layout.texts))]
    for mark, _ in layout.marks:
        places.append(slice(ENCAPSULATION + mark.start, ENCAPSULATION + mark.stop))
    return all(bool((rows[:, place] == rows[0, place]).all()) for place in places)


def joint_state_rows(
    names: Sequence[str], stamps: NDArray[np.int64], fields: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.uint8]:
    """Serialized messages, one a row.

    Args:
        names: Joint or constraint names, in the order of the columns.
        stamps: Header stamps [ns], shape (n,).
        fields: Those of position, velocity and effort that the messages carry, shape
            (n, len(names)) each.

    Raises:
        MessageError: No message can carry a stamp.
    """
    template = encoded(names, [len(names) if field in fields else 0 for field in FIELDS])
    places = zip(FIELDS, layout_of(template).slices, strict=True)
    numbers = {ENCAPSULATION + 8 * at.start: fields[f] for f, at in places if f in fields}
    return refilled(template, numbers, stamps)


class Layout(NamedTuple):
    """Places in one kind of message, as offsets after the encapsulation.

    Attributes:
        size: Length of the whole message.
        texts: Bytes of frame_id and names.
        counts: The three array lengths.
        marks: Offset and bytes of the first two; the third follows from the size.
        slices: Position, velocity and effort among the doubles that the whole body would be.
    """

    size: int
    texts: bytes
    counts: tuple[int, ...]
    marks: tuple[tuple[slice, bytes], ...]
    slices: tuple[slice, ...]
    doubles: int

    def fits(self, cdr: bytes, body: bytes) -> bool:
        """Whether a message has this layout."""
        if len(cdr) != self.size or not body.startswith(self.texts, STAMP.size):
            return False
        (position, positions), (velocity, velocities) = self.marks
        lengths_fit = body[position] == positions and body[velocity] == velocities
        return lengths_fit and cdr.startswith(LITTLE_ENDIAN)


def layout_of(cdr: bytes) -> Layout:
    """Layout of a little-endian JointState."""
    body = cdr[ENCAPSULATION:]
    at = after_text(body, STAMP.size)
    (names,) = COUNT.unpack_from(body, at)
    at += COUNT.size
    for _ in range(names):
        at = after_text(body, at)
    end_of_texts = at
    counts, marks, slices = [], [], []
    for _ in FIELDS:
        (count,) = COUNT.unpack_from(body, at)
        counts.append(count)
        marks.append((slice(at, at + COUNT.size), body[at : at + COUNT.size]))
        at += COUNT.size
        if count:
            at = aligned(at, 8)
        slices.append(slice(at // 8, at // 8 + count))
        at += 8 * count
    texts = body[STAMP.size : end_of_texts]
    arrays = tuple(counts), tuple(marks[:2]), tuple(slices)
    return Layout(len(cdr), texts, *arrays, len(body) // 8)


def encoded(names: Sequence[str], lengths: Sequence[int]) -> bytes:
    """A JointState of zeros, its position, velocity and effort of these lengths."""
    body = bytes(STAMP.size) + encoded_text("") + COUNT.pack(len(names))
    body += b"".join(map(encoded_text, names))
    for length in lengths:
        body += COUNT.pack(length)
        if length:
            body += bytes(aligned(len(body), 8) - len(body) + 8 * length)
    return HEAD + body
