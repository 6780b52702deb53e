"""Entry of the executables of the package: Ctrl-C ends them from the first line on.

What a program imports takes half a second. Until then nothing is built that would have to be
closed, and a signal ends the process at once, without a traceback out of some import.
"""

import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import FrameType

from mbd_ros.errors import BAD_INPUT, INTERRUPTED, OK, install_hint
from mbd_ros.nodes.table import NODES


def mbd_ros() -> int:
    """Entry point `mbd-ros`."""
    _end_on((signal.SIGINT,), INTERRUPTED)
    from mbd_ros.cli import main

    signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


def __getattr__(name: str) -> Callable[[], int]:
    """Entry points of the nodes."""
    if name in NODES:
        return partial(start_node, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def start_node(name: str) -> int:
    """Run a node of `NODES` until a signal ends it; the exit code."""
    _end_on((signal.SIGINT, signal.SIGTERM), OK)  # until `process.run` takes them
    module, _, node_class = NODES[name].partition(":")
    try:
        run = import_module("mbd_ros.nodes.shell.process").run
        return int(run(getattr(import_module(module), node_class)))
    except ModuleNotFoundError as error:
        hint = install_hint(str(error.name))
        if not hint:
            raise
        sys.stderr.write(f"{name}: {hint}\n")
        return BAD_INPUT


def _end_on(numbers: tuple[signal.Signals, ...], code: int) -> None:
    def end(number: int, frame: FrameType | None) -> None:
        os._exit(code)

    for number in numbers:
        signal.signal(number, end)
