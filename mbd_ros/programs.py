"""Where the executables of the package begin: Ctrl-C ends them from the first line on.

What a program imports takes half a second. Until then nothing is built that would have to be
closed, and a signal ends the process at once, without a traceback out of some import.
"""

import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from types import FrameType

from mbd_ros.errors import BAD_INPUT, INTERRUPTED, OK, install_hint


def mbd_ros() -> int:
    """Entry point `mbd-ros`."""
    _end_on((signal.SIGINT,), INTERRUPTED)
    from mbd_ros.cli import main

    signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


def _node(name: str) -> Callable[[], int]:
    """Entry point of the node in a module of this name."""

    def start() -> int:
        _end_on((signal.SIGINT, signal.SIGTERM), OK)  # until `process.run` takes them
        try:
            module = import_module(f"mbd_ros.nodes.{name}")
        except ModuleNotFoundError as error:
            hint = install_hint(str(error.name))
            if not hint:
                raise
            sys.stderr.write(f"{name}: {hint}\n")
            return BAD_INPUT
        return int(module.main())

    return start


inverse_dynamics = _node("inverse_dynamics")
joint_state_projector = _node("joint_state_projector")
qp_controller = _node("qp_controller")
reference_player = _node("reference_player")
simulator = _node("simulator")
sliding_mode_controller = _node("sliding_mode_controller")


def _end_on(numbers: tuple[signal.Signals, ...], code: int) -> None:
    def end(number: int, frame: FrameType | None) -> None:
        os._exit(code)

    for number in numbers:
        signal.signal(number, end)
