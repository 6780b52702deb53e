"""Plain CDR, the serialized form of messages: what the adapters of byte streams share.

A message begins with 4 bytes of encapsulation; places count from behind it. Numbers are aligned to
their size. A text is a count, 4 bytes, of its bytes with a final NUL, then these.

Source: OMG, DDS-XTypes 1.3, 7.4.3 (plain CDR).
"""

import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from msg_adapters.time import NANOSECONDS, seconds_of

LITTLE_ENDIAN = b"\x00\x01"  # how little-endian messages begin
HEAD = LITTLE_ENDIAN + bytes(2)  # their encapsulation
ENCAPSULATION = len(HEAD)
STAMP = struct.Struct("<iI")  # sec and nanosec, with which messages with a header begin
COUNT = struct.Struct("<I")
_STAMP_BYTES = slice(ENCAPSULATION, ENCAPSULATION + STAMP.size)


def encoded_text(text: str) -> bytes:
    """A text, and what aligns the count behind it."""
    data = text.encode() + b"\0"
    return COUNT.pack(len(data)) + data + bytes(-len(data) % COUNT.size)


def after_text(data: bytes, at: int, count: struct.Struct = COUNT) -> int:
    """Place of the count behind a text, which begins at a place aligned to 4."""
    return aligned(at + count.size + int(count.unpack_from(data, at)[0]), count.size)


def aligned(at: int, to: int) -> int:
    """The first place from here on that is a multiple of a size."""
    return -(-at // to) * to


def refilled(
    template: bytes,
    numbers: Mapping[int, NDArray[np.float64]],
    stamps: NDArray[np.int64] | None = None,
) -> NDArray[np.uint8]:
    """Copies of a little-endian message with numbers, and perhaps stamps, of their own.

    Args:
        template: Its CDR with the encapsulation.
        numbers: Place of doubles in it -> their values, one row a message.
        stamps: Those of the headers, which begin the message [ns], shape (n,).

    Returns:
        One message a row, shape (n, len(template)).

    Raises:
        MessageError: No message can carry a stamp.
    """
    count = len(next(iter(numbers.values()))) if stamps is None else len(stamps)
    rows = np.empty((count, len(template)), np.uint8)
    rows[:] = np.frombuffer(template, np.uint8)
    if stamps is not None and count:
        for extreme in (stamps.min(), stamps.max()):
            seconds_of(int(extreme))
        parts = np.stack(np.divmod(stamps, NANOSECONDS), axis=1).astype("<u4")
        rows[:, _STAMP_BYTES] = parts.view(np.uint8)
    for place, values in numbers.items():
        doubles = np.ascontiguousarray(values, dtype="<f8")
        rows[:, place : place + 8 * doubles.shape[1]] = doubles.view(np.uint8)
    return rows
