"""Checks of /clock: rclpy takes any message, and a bad one ends the process."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from msg_adapters.clock import read_clock
from msg_adapters.errors import MessageError


def guard_clock(node: Node, drop: Callable[[str], None]) -> None:
    """Let a node in simulated time ignore messages of /clock without a valid time.

    A negative second raises in rclpy, out of the callback; a nanosec of a second or more gives a
    time that no stamp can carry.

    Args:
        node: The node, as constructed.
        drop: Told of each ignored message.
    """
    source = node._time_source
    take = source.clock_callback

    def take_if_time(msg: Any) -> None:
        try:
            now = read_clock(msg)
        except MessageError as error:
            drop(f"/clock: {error}")
            return
        if now < 0:
            drop(
                f"/clock: {msg.clock.sec} s is before the beginning of time; accepted: 0 and more"
            )
            return
        take(msg)

    source.clock_callback = take_if_time  # of a subscription that is made later
    if source._clock_sub is not None:
        source._clock_sub.callback = take_if_time
