"""Which file an error is about, where the code that found it knows no files."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mbd_ros.errors import MbdError, printable


@contextmanager
def about(source: Path | str) -> Iterator[None]:
    """Errors of the core get the file or option that they are about.

    Args:
        source: File or option; errors that name it already pass as they are.
    """
    try:
        yield
    except MbdError as error:
        if printable(str(source)) in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error
