"""std_msgs/Float64MultiArray <-> vector in an agreed order."""

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError


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
    """Fill a Float64MultiArray and return it."""
    msg.data = array("d", values.tolist())
    return msg
