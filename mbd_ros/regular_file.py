"""Open regular files only, so that reading never blocks.

Opening a FIFO without a writer blocks, and a device may never end. Both are refused before
anything is read, as are sockets and directories. Symbolic links are followed by default.
"""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

_KINDS = {
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a directory",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFLNK: "a symbolic link",
}


def open_regular(path: str | Path, *, follow_links: bool = True) -> BufferedReader:
    """Open a regular file for reading.

    Raises:
        OSError: The file is missing, not readable or not a regular file; `strerror` says which.
    """
    check_regular(path, follow_links=follow_links)  # first, since opening a device may act on it
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY
    descriptor = os.open(path, flags if follow_links else flags | os.O_NOFOLLOW)
    try:
        _check_mode(os.fstat(descriptor).st_mode, path)
        return os.fdopen(descriptor, "rb")
    except OSError:
        os.close(descriptor)
        raise


def check_regular(path: str | Path, *, follow_links: bool = True) -> None:
    """Refuse a path that is not a regular file, before other code opens it.

    Raises:
        OSError: The file is missing or not a regular file; `strerror` says which.
    """
    try:
        mode = os.stat(path, follow_symlinks=follow_links).st_mode
    except ValueError as error:  # a path that no file can have
        raise OSError(errno.EINVAL, f"no file can have this name: {error}", str(path)) from error
    _check_mode(mode, path)


def _check_mode(mode: int, path: str | Path) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a special file")
        raise OSError(errno.EINVAL, f"it is {kind}, not a regular file", str(path))
