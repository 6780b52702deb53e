"""Ctrl-C ends a search after an iteration instead of the process, so that what it has is kept."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Interruption:
    """Whether somebody asked for the end.

    Attributes:
        is_asked: Whether it was.
    """

    def __init__(self) -> None:
        self.is_asked = False


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Take SIGINT for as long as the context lasts; nothing in other threads than the main one."""
    found = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield found
        return

    def ask(number: int, frame: object) -> None:
        found.is_asked = True

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield found
    finally:
        signal.signal(signal.SIGINT, before)
