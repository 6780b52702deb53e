"""std_msgs/Float64MultiArray as serialized bytes, for streams at high rates.

Layout after the 4 bytes of encapsulation, little endian: number of dimensions; of each the length
of its label, the label, which ends with a zero, and, aligned to 4, size and stride; data offset
and number of values, 4 bytes each; then, aligned to 8, the values as doubles.

Source: as `joint_state_cdr`.
"""

import math
import struct
from collections.abc import Sequence

from msg_adapters.errors import MessageError

_HEAD = bytes([0, 1, 0, 0])  # little endian


class MultiArrayCdrWriter:
    """Writes vectors of one length.

    Args:
        size: The length.
        names: Labels of dimensions, none or one a value.
    """

    def __init__(self, size: int, names: Sequence[str] = ()) -> None:
        layout = struct.pack("<I", len(names))
        for name in names:
            label = name.encode() + b"\0"
            layout += struct.pack("<I", len(label)) + label + bytes(-len(label) % 4)
            layout += struct.pack("<II", 1, 1)  # size and stride
        layout += struct.pack("<II", 0, size)
        self._head = _HEAD + layout + bytes(-len(layout) % 8)
        self._values = struct.Struct(f"<{size}d")

    def write(self, values: Sequence[float]) -> bytes:
        """A message with these values.

        Raises:
            MessageError: A value is NaN or infinite.
        """
        if not all(map(math.isfinite, values)):
            raise MessageError(f"data is not finite and is not sent: {list(values)}")
        return self._head + self._values.pack(*values)


class MatrixCdrWriter(MultiArrayCdrWriter):
    """Writes matrices, row by row.

    Two dimensions, as std_msgs has it: labels of rows and of columns, each joined by commas, the
    number of rows and of columns, and strides.

    Args:
        rows: Labels of the rows.
        columns: Labels of the columns.
    """

    def __init__(self, rows: Sequence[str], columns: Sequence[str]) -> None:
        size = len(rows) * len(columns)
        dimensions = ((rows, size), (columns, len(columns)))
        layout = struct.pack("<I", len(dimensions))
        for names, stride in dimensions:
            label = ",".join(names).encode() + b"\0"
            layout += struct.pack("<I", len(label)) + label + bytes(-len(label) % 4)
            layout += struct.pack("<II", len(names), stride)
        layout += struct.pack("<II", 0, size)
        self._head = _HEAD + layout + bytes(-len(layout) % 8)
        self._values = struct.Struct(f"<{size}d")
