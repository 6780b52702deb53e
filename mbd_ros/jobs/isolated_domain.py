"""A DDS domain for this process and the processes that it starts."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import rclpy
from rclpy.signals import SignalHandlerOptions

from mbd_ros.jobs.domain_claim import claimed_domain


class IsolatedDomain(NamedTuple):
    """A domain that this process has joined.

    Attributes:
        environment: Environment for processes that shall join the domain.
        check: Raises KeyboardInterrupt after Ctrl-C or SIGTERM. Call it often.
    """

    environment: dict[str, str]
    check: Callable[[], None]


@contextmanager
def isolated_domain() -> Iterator[IsolatedDomain]:
    """Join a DDS domain that no other program uses, on this machine only.

    Ctrl-C and SIGTERM take effect in `check`, or else at the end of the `with` block: an exception
    that a signal raises inside of rclpy, which calls Python from C, crashes the process.

    Raises:
        NoDomainError: All domains are taken.
    """
    before = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE")
    signals: list[int] = []

    def check() -> None:
        if signals:
            raise KeyboardInterrupt

    with claimed_domain() as domain:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        # rclpy's own handlers shut down the context in the middle of whatever runs.
        rclpy.init(args=[], domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        handlers = {
            number: signal.signal(number, lambda number, _: signals.append(number))
            for number in (signal.SIGINT, signal.SIGTERM)
        }
        try:
            yield IsolatedDomain({**os.environ, "ROS_DOMAIN_ID": str(domain)}, check)
            check()
        finally:
            rclpy.try_shutdown()
            for number, handler in handlers.items():
                signal.signal(number, handler)
            if before is None:
                del os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]
            else:
                os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = before
