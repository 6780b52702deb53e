"""builtin_interfaces/Time and rosgraph_msgs/Clock <-> integer nanoseconds."""

from typing import Any

from msg_adapters.errors import MessageError

NANOSECONDS = 1_000_000_000
_FIRST, _END = -(2**31) * NANOSECONDS, 2**31 * NANOSECONDS  # what sec, an int32, can say


def read_time(msg: Any) -> int:
    """Stamp of a message [ns].

    Raises:
        MessageError: Its nanosec is a second or more: no message could carry the sum back.
    """
    return stamp_of(int(msg.sec), int(msg.nanosec))


def write_time(msg: Any, stamp: int) -> None:
    """Put `stamp` [ns] into a Time message.

    Raises:
        MessageError: No message can carry it.
    """
    msg.sec, msg.nanosec = seconds_of(stamp)


def stamp_of(sec: int, nanosec: int) -> int:
    """Both parts of a Time as one number [ns]."""
    if not 0 <= nanosec < NANOSECONDS:
        raise MessageError(f"stamp: nanosec is {nanosec}, accepted: 0 to {NANOSECONDS - 1}")
    return sec * NANOSECONDS + nanosec


def seconds_of(stamp: int) -> tuple[int, int]:
    """Whole seconds and remaining nanoseconds of a stamp [ns]."""
    if not _FIRST <= stamp < _END:
        raise MessageError(
            f"stamp: {stamp / NANOSECONDS:.9g} s does not fit into a message, whose seconds are "
            f"an int32; accepted: -{2**31} to {2**31 - 1} s"
        )
    return divmod(stamp, NANOSECONDS)


def read_clock(msg: Any) -> int:
    """Time of one message [ns]."""
    return read_time(msg.clock)


def write_clock(msg: Any, stamp: int) -> Any:
    """Put a time [ns] into a Clock message and return it."""
    write_time(msg.clock, stamp)
    return msg
