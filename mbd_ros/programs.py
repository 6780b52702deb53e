"""Entry of the executables of the package: Ctrl-C ends them from the first line on.

What a program imports takes half a second. Until then nothing is built that would have to be
closed, and a signal ends the process at once, without a traceback out of some import.
"""

import signal
from collections.abc import Callable
from functools import partial

from mbd_ros.errors import INTERRUPTED
from mbd_ros.nodes.start import end_on, start_node
from mbd_ros.nodes.table import NODES


def mbd_ros() -> int:
    """Entry point `mbd-ros`."""
    end_on((signal.SIGINT,), INTERRUPTED)
    from mbd_ros.cli import main

    signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


def __getattr__(name: str) -> Callable[[], int]:
    """Entry points of the nodes."""
    if name in NODES:
        return partial(start_node, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
