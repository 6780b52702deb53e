"""The file of an error, where the code that raised it knows no files."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mbd_ros.errors import MbdError, printable


@contextmanager
def about(source: Path | str) -> Iterator[None]:
    """Add the file or option to errors of the core.

    Args:
        source: File or option; errors that name it already pass as they are.
    """
    try:
        yield
    except MbdError as error:
        if printable(str(source)) in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error
