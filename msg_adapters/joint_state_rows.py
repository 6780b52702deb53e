"""Many serialized sensor_msgs/JointState of one layout <-> arrays."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointStateReader
from msg_adapters.joint_state_cdr import (
    ENCAPSULATION,
    FIELDS,
    LITTLE_ENDIAN,
    Layout,
    encoded,
    layout_of,
)
from msg_adapters.rows import refilled
from msg_adapters.time import NANOSECONDS

_STAMP = 8  # bytes of sec and nanosec


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
        stamps = np.ascontiguousarray(body[:, :_STAMP])
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


def _is_one(rows: NDArray[np.uint8], layout: Layout) -> bool:
    """Whether all have the encapsulation, the texts and the array lengths of the first."""
    begin = ENCAPSULATION + _STAMP
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
