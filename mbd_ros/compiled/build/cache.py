"""Compiled libraries in the cache folder of the user.

A library stands in the folder under its key, with a digest of key and content at its end: what
was cut, changed or copied from elsewhere is built again and never executed. It is written beside
and put in place in one step, under a lock, so that processes that want the same one wait for one
another and one that was killed leaves nothing that counts.
"""

import fcntl
import hashlib
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mbd_ros.compiled.build.compiler import BuildError

Say = Callable[[str], None]
Build = Callable[[Path], Path]
_DIGEST = 64  # characters
_UNUSED = 90 * 86400.0  # s after which a library is removed when another one is built


def cache_folder() -> Path:
    """Where libraries are kept; it need not exist.

    Raises:
        OSError: The user has no home.
    """
    named = os.environ.get("XDG_CACHE_HOME", "")
    home = os.path.expanduser("~")
    if not (named.startswith("/") or home.startswith("/")):
        raise OSError("no home folder of the user, and no XDG_CACHE_HOME")
    root = Path(named) if named.startswith("/") else Path(home) / ".cache"
    return root / "mbd_ros" / "compiled"


def kept(key: str, build: Build, say: Say, *, again: bool = False) -> bytes:
    """The library of a key in the cache folder, built there if need be.

    What is loaded are these bytes and not the file, which may change meanwhile.

    Args:
        key: Of the library: letters and digits.
        build: Makes it in the folder that it is given.
        say: Is told what is waited for.
        again: Build it even if there is one.

    Raises:
        BuildError: The folder is not to be trusted, or the library cannot be built.
        OSError: The folder cannot be used.
    """
    folder = cache_folder()
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    _check(folder)
    library = folder / f"{key}.so"
    found = None if again else _intact(library, key)
    if found is not None:
        return found
    with _lock(folder / f"{key}.lock", say):
        found = None if again else _intact(library, key)
        if found is not None:
            return found
        for left in folder.glob(f"{key}.*.part"):  # of a process that was killed
            shutil.rmtree(left, ignore_errors=True)
        _remove_unused(folder)
        part = Path(tempfile.mkdtemp(prefix=f"{key}.", suffix=".part", dir=folder))
        try:
            return _put(build(part), library, key)
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def private() -> Iterator[Path]:
    """A folder of this process alone, removed afterwards: what is loaded stays loaded.

    Raises:
        BuildError: There is no place for one, or it cannot be written.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="mbd_ros_", ignore_cleanup_errors=True) as name:
            yield Path(name)
    except OSError as error:
        place = error.filename or "the folder for temporary files"
        raise BuildError(f"{place}: {error.strerror or error}") from error


def _check(folder: Path) -> None:
    """Whether only the user can write to a folder.

    Raises:
        BuildError: Somebody else can.
    """
    status = folder.stat()
    if status.st_uid != os.geteuid():
        raise BuildError(f"{folder} belongs to another user")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise BuildError(f"{folder} can be written by others: chmod go-w {folder}")


def _intact(library: Path, key: str) -> bytes | None:
    """The library that was put in a place under this key by the user, None without."""
    try:
        with library.open("rb") as file:
            status = os.fstat(file.fileno())
            content = file.read()
    except OSError:
        return None
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    own = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid() and not others
    found, digest = content[:-_DIGEST], content[-_DIGEST:]
    if not own or digest != _digest(key, found):
        return None
    with suppress(OSError):
        os.utime(library)
    return found


def _remove_unused(folder: Path) -> None:
    """Removes what nobody has loaded for long."""
    before = time.time() - _UNUSED
    for path in (*folder.glob("*.so"), *folder.glob("*.lock")):
        with suppress(OSError):
            if path.stat().st_mtime < before:
                path.unlink()


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(key.encode() + content).hexdigest().encode()


def _put(built: Path, library: Path, key: str) -> bytes:
    """Puts a library in its place, whole or not at all, and gives its content."""
    content = built.read_bytes()
    with built.open("ab") as file:
        file.write(_digest(key, content))
        file.flush()
        os.fsync(file.fileno())
    built.chmod(0o600)
    built.replace(library)
    return content


@contextmanager
def _lock(path: Path, say: Say) -> Iterator[None]:
    """Waits until no other process builds the same; file systems without locks do not wait."""
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another process compiles the same: waiting for it")
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError:
            say("the cache folder has no locks: compiling without")
        yield
