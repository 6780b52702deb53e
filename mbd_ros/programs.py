"""Entry points of the executables; Ctrl-C ends them without a traceback at any time.

Imports take half a second. Until they are done, nothing is open that would have to be closed, so
a signal ends the process at once.
"""

import signal
from collections.abc import Callable
from functools import partial

from mbd_ros.errors import INTERRUPTED
from mbd_ros.nodes.start import end_on, start_node
from mbd_ros.nodes.table import NODES


def mbd_ros() -> int:
    """Run the command line program `mbd-ros`."""
    end_on((signal.SIGINT,), INTERRUPTED)
    from mbd_ros.cli import main

    signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


def __getattr__(name: str) -> Callable[[], int]:
    """Return the entry point of the node with this name."""
    if name in NODES:
        return partial(start_node, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
