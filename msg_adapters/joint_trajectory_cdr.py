"""How many names and points a serialized JointTrajectory claims, before it is read.

Layout as in `joint_state_cdr`: stamp, frame_id, number of names, names, number of points.
"""

import struct

from msg_adapters.errors import MessageError
from msg_adapters.joint_trajectory import require_few

_MOST_NAMES = 4000
_STAMP_END = 12  # after the encapsulation and the stamp


def require_points(cdr: bytes) -> None:
    """Refuse a trajectory with too many points before it is read.

    Args:
        cdr: JointTrajectory with its encapsulation.

    Raises:
        MessageError: More than `MOST_POINTS` points, 4000 names, or bytes that end before their
            numbers.
    """
    order = "<" if cdr[1:2] == b"\x01" else ">"
    count = struct.Struct(f"{order}I")
    try:
        at = _after_text(count, cdr, _STAMP_END)
        (names,) = count.unpack_from(cdr, at)
        at += count.size
        if names > _MOST_NAMES:
            raise MessageError(f"{names} joint names, accepted: {_MOST_NAMES}")
        for _ in range(names):
            at = _after_text(count, cdr, at)
        (points,) = count.unpack_from(cdr, at)
    except struct.error as error:
        raise MessageError("its bytes are no JointTrajectory") from error
    require_few(points)


def _after_text(count: struct.Struct, cdr: bytes, at: int) -> int:
    """Where the value after a text begins; counts are aligned to 4."""
    end = at + count.size + int(count.unpack_from(cdr, at)[0])
    return end + -end % count.size
