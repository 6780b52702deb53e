"""Lines of a command for people."""

import sys
from collections.abc import Callable, Iterable

from mbd_ros.errors import printable

Say = Callable[[str], None]  # what is told such lines


def say(line: str) -> None:
    """Write a line to the output at once; names in it come from files of others."""
    sys.stdout.write(f"{printable(line)}\n")
    sys.stdout.flush()


def say_all(lines: Iterable[str]) -> None:
    """Write lines as they come."""
    for line in lines:
        say(line)
