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
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mbd_ros.compiled.build.compiler import BuildError

Say = Callable[[str], None]
Build = Callable[[Path], Path]
_DIGEST = 64  # characters


def cache_folder() -> Path:
    """Where libraries are kept; it need not exist."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    root = Path(named) if named.startswith("/") else Path("~/.cache").expanduser()
    return root / "mbd_ros" / "compiled"


@contextmanager
def entry(key: str, build: Build, say: Say, *, again: bool = False) -> Iterator[Path]:
    """The library of a key, built where there is none that can be trusted.

    Where the cache folder cannot be used it is built in a folder of this process, for the length
    of the `with` block.

    Args:
        key: Of the library: letters and digits.
        build: Makes it in the folder that it is given.
        say: Is told why the cache folder is not used, and what is waited for.
        again: Build it even if there is one.

    Raises:
        BuildError: It cannot be built.
    """
    try:
        found = _kept(cache_folder(), key, build, say, again)
    except (OSError, RuntimeError, BuildError) as error:
        say(f"not kept in the cache: {error}")
        with _private() as folder:
            try:
                yield build(folder)
            except OSError as failed:
                raise BuildError(f"{folder}: {failed.strerror}") from failed
    else:
        yield found


def _kept(folder: Path, key: str, build: Build, say: Say, again: bool) -> Path:
    """The library in the cache folder, built if need be."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    _check(folder)
    library = folder / f"{key}.so"
    if not again and _intact(library, key):
        return library
    with _lock(folder / f"{key}.lock", say):
        if again or not _intact(library, key):
            for left in folder.glob(f"{key}.*.part"):  # of a process that was killed
                shutil.rmtree(left, ignore_errors=True)
            part = Path(tempfile.mkdtemp(prefix=f"{key}.", suffix=".part", dir=folder))
            try:
                _put(build(part), library, key)
            finally:
                shutil.rmtree(part, ignore_errors=True)
    return library


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


def _intact(library: Path, key: str) -> bool:
    """Whether a file belongs to the user, and is the library that was put there under this key."""
    try:
        with library.open("rb") as file:
            status = os.fstat(file.fileno())
            content = file.read()
    except OSError:
        return False
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    own = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid() and not others
    return own and content[-_DIGEST:] == _digest(key, content[:-_DIGEST])


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(key.encode() + content).hexdigest().encode()


def _put(built: Path, library: Path, key: str) -> None:
    """Puts a library in its place, whole or not at all."""
    content = built.read_bytes()
    with built.open("ab") as file:  # loaders read no further than the tables of the file say
        file.write(_digest(key, content))
        file.flush()
        os.fsync(file.fileno())
    built.chmod(0o700)
    built.replace(library)


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


@contextmanager
def _private() -> Iterator[Path]:
    """A folder of this process, removed afterwards: what is loaded stays loaded."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="mbd_ros_"))
    except OSError as error:
        raise BuildError(f"no folder for a compiled scene: {error.strerror}") from error
    try:
        yield folder
    finally:
        with suppress(OSError):
            shutil.rmtree(folder)
