"""How far a long loop is, for whoever watches."""

import sys
import time
from collections.abc import Iterable, Iterator
from multiprocessing import parent_process
from typing import TypeVar

T = TypeVar("T")
PERIOD = 0.2  # s


def progress(iterable: Iterable[T], total: int, label: str) -> Iterator[T]:
    """Pass items on and keep one line with a percentage on stderr, if that is a terminal.

    Args:
        iterable: The items.
        total: How many there will be.
        label: What is going on.

    Yields:
        The items, unchanged.
    """
    if not sys.stderr.isatty() or parent_process() is not None:  # workers leave the line to it
        yield from iterable
        return
    due = 0.0
    try:
        for done, item in enumerate(iterable):
            if time.monotonic() >= due:
                due = time.monotonic() + PERIOD
                sys.stderr.write(f"\r{label} {min(100 * done // max(total, 1), 100)} %")
                sys.stderr.flush()
            yield item
    finally:
        sys.stderr.write("\r\x1b[K")  # erase the line
        sys.stderr.flush()
