"""Where the executables of the package begin: Ctrl-C ends them from the first line on.

What a program imports takes half a second. Until then nothing is built that would have to be
closed, and a signal ends the process at once, without a traceback out of some import.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from mbd_ros.errors import install_hint

BAD_INPUT, INTERRUPTED = 2, 130


def mbd_ros() -> int:
    """Entry point `mbd-ros`."""
    _end_on((signal.SIGINT,), INTERRUPTED)
    from mbd_ros.cli import main

    signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


def inverse_dynamics() -> int:
    """Entry point `inverse_dynamics`."""
    _end_on_signals()
    with _naming_what_is_missing("inverse_dynamics"):
        from mbd_ros.nodes.inverse_dynamics import main
    return main()


def joint_state_projector() -> int:
    """Entry point `joint_state_projector`."""
    _end_on_signals()
    with _naming_what_is_missing("joint_state_projector"):
        from mbd_ros.nodes.joint_state_projector import main
    return main()


def qp_controller() -> int:
    """Entry point `qp_controller`."""
    _end_on_signals()
    with _naming_what_is_missing("qp_controller"):
        from mbd_ros.nodes.qp_controller import main
    return main()


def reference_player() -> int:
    """Entry point `reference_player`."""
    _end_on_signals()
    from mbd_ros.nodes.reference_player import main

    return main()


def simulator() -> int:
    """Entry point `simulator`."""
    _end_on_signals()
    with _naming_what_is_missing("simulator"):
        from mbd_ros.nodes.simulator import main
    return main()


def sliding_mode_controller() -> int:
    """Entry point `sliding_mode_controller`."""
    _end_on_signals()
    with _naming_what_is_missing("sliding_mode_controller"):
        from mbd_ros.nodes.sliding_mode_controller import main
    return main()


@contextmanager
def _naming_what_is_missing(node: str) -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as error:
        hint = install_hint(str(error.name))
        if not hint:
            raise
        sys.stderr.write(f"{node}: {hint}\n")
        raise SystemExit(BAD_INPUT) from error


def _end_on_signals() -> None:
    """Let a signal end the process of a node, until `process.run` takes it."""
    _end_on((signal.SIGINT, signal.SIGTERM), 0)


def _end_on(numbers: tuple[signal.Signals, ...], code: int) -> None:
    def end(number: int, frame: FrameType | None) -> None:
        os._exit(code)

    for number in numbers:
        signal.signal(number, end)
