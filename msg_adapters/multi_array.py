"""std_msgs/Float64MultiArray <-> vector in an agreed order."""

import re
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError
from msg_adapters.finite import require_finite
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


def write_multi_array(msg: Any, values: NDArray[np.float64]) -> Any:
    """Fill a Float64MultiArray and return it.

    Raises:
        MessageError: A value is NaN or infinite.
    """
    require_finite(data=values)
    msg.data = array("d", values.tolist())
    return msg
