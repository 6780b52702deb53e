"""A DDS domain for this process and those that it starts."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.signals import SignalHandlerOptions

from mbd_ros.jobs.domain_claim import claimed_domain


@contextmanager
def isolated_domain() -> Iterator[dict[str, str]]:
    """Environment of processes on a DDS domain that this one has joined, on this machine only.

    SIGTERM raises KeyboardInterrupt, as Ctrl-C does.

    Raises:
        NoDomainError: All domains are taken.
    """
    before = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE")
    with claimed_domain() as domain:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        # rclpy's own handlers shut down the context in the middle of whatever runs.
        rclpy.init(args=[], domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        on_terminate = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            yield {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        finally:
            signal.signal(signal.SIGTERM, on_terminate)
            rclpy.try_shutdown()
            if before is None:
                del os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]
            else:
                os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = before
