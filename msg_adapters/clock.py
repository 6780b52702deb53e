"""rosgraph_msgs/Clock <-> integer nanoseconds."""

from typing import Any

from msg_adapters.time import read_time, write_time


def read_clock(msg: Any) -> int:
    """Time of one message [ns]."""
    return read_time(msg.clock)


def write_clock(msg: Any, stamp: int) -> Any:
    """Put a time [ns] into a Clock message and return it."""
    write_time(msg.clock, stamp)
    return msg
