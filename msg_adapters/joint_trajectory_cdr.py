"""How many points a serialized trajectory_msgs/JointTrajectory claims, before it is read.

Layout as in `joint_state_cdr`: stamp, frame_id, names, and then the number of points.
"""

import struct

from msg_adapters.errors import MessageError

MOST_POINTS = 3000
_STAMP_END = 12  # after the encapsulation and the stamp


def require_points(cdr: bytes) -> None:
    """Refuse a trajectory whose reading would hold a control loop up.

    Args:
        cdr: JointTrajectory with its encapsulation.

    Raises:
        MessageError: More than `MOST_POINTS` points, or bytes that end before their number.
    """
    order = "<" if cdr[1:2] == b"\x01" else ">"
    count = struct.Struct(f"{order}I")
    try:
        at = _after_text(count, cdr, _STAMP_END)
        (names,) = count.unpack_from(cdr, at)
        at += count.size
        for _ in range(names):
            at = _after_text(count, cdr, at)
        (points,) = count.unpack_from(cdr, at)
    except struct.error as error:
        raise MessageError("its bytes are no JointTrajectory") from error
    if points > MOST_POINTS:
        raise MessageError(
            f"{points} points, accepted: {MOST_POINTS}, so that reading them does not hold the "
            "loop up; send it in parts, or with points further apart"
        )


def _after_text(count: struct.Struct, cdr: bytes, at: int) -> int:
    """Where the value after a text begins; counts are aligned to 4."""
    end = at + count.size + int(count.unpack_from(cdr, at)[0])
    return end + -end % count.size
