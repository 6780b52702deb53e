"""Progress of a long loop, and lines of a command, for people."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from multiprocessing import parent_process
from typing import TypeVar

from mbd_ros.errors import printable

T = TypeVar("T")
Watch = bool | Callable[[str, float], None]
PERIOD = 0.2  # s
_WATCH: ContextVar[Watch] = ContextVar("watch", default=True)
Say = Callable[[str], None]  # takes a line for people


def progress(iterable: Iterable[T], total: int, label: str) -> Iterator[T]:
    """Yield the items and show the share that is done on stderr, if that is a terminal."""
    most = max(total, 1)
    return progress_of(((done / most, item) for done, item in enumerate(iterable)), label)


def progress_of(pairs: Iterable[tuple[float, T]], label: str) -> Iterator[T]:
    """Yield items that come with the share that is done before them, and show that share."""
    with share_watch(label) as tell:
        for share, item in pairs:
            tell(share)
            yield item


@contextmanager
def share_watch(label: str) -> Iterator[Callable[[float], None]]:
    """Yield a function that shows the share that is done, for work that is no loop over items."""
    watch, due = _watch(), 0.0
    tell = _write if watch is True else watch

    def show(share: float) -> None:
        nonlocal due
        if tell is not False and time.monotonic() >= due:
            due = time.monotonic() + PERIOD
            tell(label, min(share, 1.0))

    try:
        yield show
    finally:
        if watch is True:
            sys.stderr.write("\r\x1b[K")  # erase the line
            sys.stderr.flush()


def _watch() -> Watch:
    """Return the listener; worker processes leave the terminal to their parent."""
    watch = _WATCH.get()
    if watch is True and (not sys.stderr.isatty() or parent_process() is not None):
        return False
    return watch


def _write(label: str, share: float) -> None:
    sys.stderr.write(f"\r{label} {int(100 * share)} %")
    sys.stderr.flush()


@contextmanager
def watching(watch: Watch) -> Iterator[None]:
    """Choose the listener of `progress` within the block.

    Args:
        watch: True for a terminal, False for none, or a function of a label and the share that is
            done, which is called at most every `PERIOD` seconds.
    """
    before = _WATCH.set(watch)
    try:
        yield
    finally:
        _WATCH.reset(before)


def announce(line: str) -> None:
    """Write on a terminal what the program is about to do, unless somebody else listens."""
    if _watch() is True:
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def say(line: str) -> None:
    """Write a line to stdout at once, with unprintable characters of foreign names escaped."""
    sys.stdout.write(f"{printable(line)}\n")
    sys.stdout.flush()


def say_all(lines: Iterable[str]) -> None:
    """Write lines to stdout as they come."""
    for line in lines:
        say(line)
