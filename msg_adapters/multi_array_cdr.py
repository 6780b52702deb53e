"""std_msgs/Float64MultiArray as serialized bytes, for streams at high rates.

Layout after the 4 bytes of encapsulation, little endian: number of dimensions, none here, data
offset and number of values, 4 bytes each, then, aligned to 8, the values as doubles.

Source: as `joint_state_cdr`.
"""

import math
import struct
from collections.abc import Sequence

from msg_adapters.errors import MessageError

_HEAD = bytes([0, 1, 0, 0])  # little endian
_LAYOUT = "<III"


class MultiArrayCdrWriter:
    """Writes vectors of one length.

    Args:
        size: The length, > 0.
    """

    def __init__(self, size: int) -> None:
        layout = struct.pack(_LAYOUT, 0, 0, size)
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
