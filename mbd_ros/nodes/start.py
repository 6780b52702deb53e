"""A node as a process of its own; nothing heavy is imported before signals end it."""

import os
import signal
import sys
from importlib import import_module
from types import FrameType

from mbd_ros.errors import BAD_INPUT, OK, install_hint
from mbd_ros.nodes.table import NODES


def start_node(name: str) -> int:
    """Run a node of `NODES` until a signal ends it; the exit code."""
    end_on((signal.SIGINT, signal.SIGTERM), OK)  # until `process.run` takes them
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


def end_on(numbers: tuple[signal.Signals, ...], code: int) -> None:
    """End this process with an exit code at the first of these signals."""

    def end(number: int, frame: FrameType | None) -> None:
        os._exit(code)

    for number in numbers:
        signal.signal(number, end)
