"""Many serialized messages that differ in their numbers only, one a row of bytes."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from msg_adapters.time import NANOSECONDS, seconds_of

_STAMP = slice(4, 12)  # sec and nanosec, behind the encapsulation


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
        rows[:, _STAMP] = parts.view(np.uint8)
    for place, values in numbers.items():
        doubles = np.ascontiguousarray(values, dtype="<f8")
        rows[:, place : place + 8 * doubles.shape[1]] = doubles.view(np.uint8)
    return rows
