"""std_msgs/Float64MultiArray <-> vector, in an agreed order or by labels.

Messages are also written as serialized bytes, for streams at high rates.
"""

import math
import re
import struct
from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.cdr import COUNT, HEAD, encoded_text
from msg_adapters.errors import MessageError, require_finite
from msg_adapters.time import NANOSECONDS

_STAMP = re.compile(r"(\d{1,10})\.(\d{9})", re.ASCII)


def read_multi_array(msg: Any, size: int) -> NDArray[np.float64]:
    """Vector of one message.

    Args:
        msg: Float64MultiArray; its layout is not read, as ros2_control does not write one.
        size: Length that both sides agreed on.

    Raises:
        MessageError: Another length, or a value that is NaN or infinite.
    """
    if len(msg.data) != size:
        raise MessageError(f"data has {len(msg.data)} values, expected {size}")
    values = np.array(msg.data, dtype=np.float64)
    if not np.isfinite(values).all():
        raise MessageError(f"data is not finite: {values.tolist()}")
    return values


def write_multi_array(msg: Any, values: NDArray[np.float64]) -> Any:
    """Fill a Float64MultiArray and return it.

    Raises:
        MessageError: A value is NaN or infinite.
    """
    require_finite(data=values)
    msg.data = array("d", values.tolist())
    return msg


def values_by_label(msg: Any, labels: Sequence[str]) -> NDArray[np.float64]:
    """Values of one message by the labels of its dimensions, one each.

    Args:
        msg: Float64MultiArray whose layout has a dimension a value, or none.
        labels: Those asked for.

    Returns:
        Shape (len(labels),), NaN where a label is missing.
    """
    data, dimensions = msg.data, msg.layout.dim
    values_of = (
        {one.label: at for at, one in enumerate(dimensions)}
        if len(dimensions) == len(data)
        else {}
    )
    rows = [values_of.get(label) for label in labels]
    return np.array([math.nan if row is None else data[row] for row in rows], dtype=np.float64)


def read_answered(msg: Any) -> int | None:
    """Stamp of the joint state that a command answers [ns]; None where it names none.

    It stands in the label of the only dimension as `seconds.nanoseconds`, the latter with nine
    digits. Readers may ignore it.
    """
    dimensions: Any = getattr(getattr(msg, "layout", None), "dim", ())
    said = _STAMP.fullmatch(dimensions[0].label) if len(dimensions) == 1 else None
    return int(said[1]) * NANOSECONDS + int(said[2]) if said else None


def write_answered(msg: Any, size: int, stamp: int) -> None:
    """Name the joint state that a command answers, in the only dimension of its layout.

    Args:
        msg: Float64MultiArray with one dimension.
        size: Number of values.
        stamp: Of the joint state [ns].
    """
    (dimension,) = msg.layout.dim
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    dimension.label, dimension.size, dimension.stride = f"{seconds}.{nanoseconds:09d}", size, size


class MultiArrayCdrWriter:
    """Writes vectors of one length as serialized messages, for streams at high rates.

    Layout after the encapsulation, little endian: number of dimensions; of each its label, size
    and stride; data offset and number of values, 4 bytes each; then, aligned to 8, the values as
    doubles.

    Args:
        names: Labels of dimensions, none or one a value.
    """

    def __init__(self, size: int, names: Sequence[str] = ()) -> None:
        self._lay_out([(name, 1, 1) for name in names], size)

    def write(self, values: Sequence[float]) -> bytes:
        """A message with these values.

        Raises:
            MessageError: A value is NaN or infinite.
        """
        if not all(map(math.isfinite, values)):
            raise MessageError(f"data is not finite and is not sent: {list(values)}")
        return self._head + self._values.pack(*values)

    def _lay_out(self, dimensions: Sequence[tuple[str, int, int]], size: int) -> None:
        """Dimensions are labels, sizes and strides."""
        layout = COUNT.pack(len(dimensions))
        for label, count, stride in dimensions:
            layout += encoded_text(label) + struct.pack("<II", count, stride)
        layout += struct.pack("<II", 0, size)
        self._head = HEAD + layout + bytes(-len(layout) % 8)
        self._values = struct.Struct(f"<{size}d")


class MatrixCdrWriter(MultiArrayCdrWriter):
    """Writes matrices, row by row.

    Two dimensions, as std_msgs has it: labels of rows and of columns, each joined by commas, the
    number of rows and of columns, and strides.
    """

    def __init__(self, rows: Sequence[str], columns: Sequence[str]) -> None:
        size = len(rows) * len(columns)
        dimensions = (
            (",".join(rows), len(rows), size),
            (",".join(columns), len(columns), len(columns)),
        )
        self._lay_out(dimensions, size)
