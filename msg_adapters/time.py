"""builtin_interfaces/Time <-> integer nanoseconds."""

from typing import Any

NANOSECONDS = 1_000_000_000


def read_time(msg: Any) -> int:
    """Stamp of a message [ns]."""
    return int(msg.sec) * NANOSECONDS + int(msg.nanosec)


def write_time(msg: Any, stamp: int) -> None:
    """Put `stamp` [ns] into a Time message."""
    msg.sec, msg.nanosec = divmod(stamp, NANOSECONDS)
