"""Native code in this process, kept in the cache folder of the user.

A library stands in the folder under its key, with a digest of key and content at its end: what was
cut, changed or copied from elsewhere is built again and never executed. It is written beside and
put in place in one step, under a lock, so that processes that want the same one wait for one
another and one that was killed leaves nothing that counts. Links in the folder are not followed.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import itertools
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from mbd_ros.compiled.build.compiler import FLAGS, BuildError, Compiler, cpu, find_compiler
from mbd_ros.compiled.code.source import Signature, Source
from mbd_ros.core.state import Array
from mbd_ros.regular_file import check_regular, open_regular

Say = Callable[[str], None]
Build = Callable[[Path], Path]
_DIGEST = 64  # characters
_UNUSED = 90 * 86400.0  # s after which a library is removed when another one is built
_ALIGNED = 64  # bytes, of the widest vectors
_SECONDS = 12  # characters
_FORMAT = "the library, then the seconds that it took"
_loaded = itertools.count(1)
Check = Callable[["Library"], None]


def _silent(line: str) -> None:
    """Says nothing."""


def _trusted(library: Library) -> None:
    """Refuses nothing."""


def load(source: Source, say: Say = _silent, check: Check = _trusted) -> Library:
    """A library of C source, from the cache or compiled now.

    Where the cache folder cannot be used, it is compiled in a folder of this process alone.

    Args:
        source: The source; whole programs may stand behind the functions in its text.
        say: Is told what takes time, and why something is not kept.
        check: Asked once the library is loaded; what it refuses is compiled again, once.

    Raises:
        BuildError: There is no compiler, it fails, what it wrote cannot be loaded, or is refused.
    """
    compiler = find_compiler()

    def build(folder: Path) -> Path:
        say(f"compiling {sum(source.operations.values())} operations by {compiler.name}")
        start = time.perf_counter()
        built = compiler.build((source.text, *source.units), folder)
        seconds = time.perf_counter() - start
        with built.open("ab") as file:  # loaders read no further than the tables of the file say
            file.write(f"{seconds:{_SECONDS}.2f}".encode())
        say(f"compiled in {seconds:.1f} s")
        return built

    for again in (False, True):
        try:
            content = cached_library(_key(source, compiler), build, say, again=again)
            library = Library(source, content, compiler.name)
        except (OSError, BuildError) as error:
            with private() as folder:
                library = Library(source, build(folder).read_bytes(), compiler.name)
            say(f"not kept: {_reason(error)}")
            check(library)
            return library
        try:
            check(library)
        except BuildError as error:
            if again:
                raise
            say(f"compiling again: {error}")
        else:
            break
    return library


def _reason(error: OSError | BuildError) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error).splitlines()[0]


def cached_library(key: str, build: Build, say: Say, *, again: bool = False) -> bytes:
    """Return a library from the cache folder, and build it first if it is missing.

    The caller must load these bytes and not the file, which may change in the meantime.

    Args:
        key: Key of the library: letters and digits.
        build: Function that builds the library in a folder.
        say: Function that receives progress messages.
        again: Whether to build it even if it exists.

    Raises:
        BuildError: The folder is not safe, or the library cannot be built.
        OSError: The folder cannot be used.
    """
    folder = cache_folder()
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    _check(folder)
    library = folder / f"{key}.so"
    content = None if again else _intact(library, key)
    if content is not None:
        return content
    with _lock(folder / f"{key}.lock", say):
        content = None if again else _intact(library, key)
        if content is not None:
            return content
        for unfinished in folder.glob(f"{key}.*.part"):  # of a process that was killed
            shutil.rmtree(unfinished, ignore_errors=True)
        _remove_unused(folder)
        part = Path(tempfile.mkdtemp(prefix=f"{key}.", suffix=".part", dir=folder))
        try:
            return _put(build(part), library, key)
        finally:
            shutil.rmtree(part, ignore_errors=True)


def cache_folder() -> Path:
    """Return the folder of cached libraries, which need not exist.

    Raises:
        OSError: The user has no home folder.
    """
    named = os.environ.get("XDG_CACHE_HOME", "")
    home = os.path.expanduser("~")
    if not (named.startswith("/") or home.startswith("/")):
        raise OSError("the user has no home folder; set XDG_CACHE_HOME to an absolute path")
    root = Path(named) if named.startswith("/") else Path(home) / ".cache"
    return root / "mbd_ros" / "compiled"


def _check(folder: Path) -> None:
    """Check that a folder is not a link and that only the user can write to it.

    Raises:
        BuildError: It is a link, or others can write to it.
    """
    for path in (folder.parent, folder):
        if path.is_symlink():
            raise BuildError(f"{path} is a symbolic link; replace it by a folder")
    status = folder.stat()
    if status.st_uid != os.geteuid():
        raise BuildError(f"{folder} belongs to another user")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise BuildError(f"{folder} can be written by others: chmod go-w {folder}")


def _intact(library: Path, key: str) -> bytes | None:
    """Return the library that the user has stored under a key; None if there is none."""
    try:
        with open_regular(library, follow_links=False) as file:
            status = os.fstat(file.fileno())
            content = file.read()
            with suppress(OSError):  # where nothing can be written
                os.utime(file.fileno())
    except OSError:
        return None
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    binary, digest = content[:-_DIGEST], content[-_DIGEST:]
    if status.st_uid != os.geteuid() or others or digest != _digest(key, binary):
        return None
    return binary


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(key.encode() + content).hexdigest().encode()


@contextmanager
def _lock(path: Path, say: Say) -> Iterator[None]:
    """Wait until no other process builds the same library, if the file system has locks.

    Raises:
        OSError: The lock file cannot be created.
    """
    with suppress(FileNotFoundError):
        check_regular(path, follow_links=False)
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    with open(os.open(path, flags, 0o600), "wb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another process compiles the same code: waiting for it")
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError:
            say("the cache folder has no locks: compiling without")
        yield


def _remove_unused(folder: Path) -> None:
    """Remove libraries that have not been loaded for a long time."""
    before = time.time() - _UNUSED
    for path in (*folder.glob("*.so"), *folder.glob("*.lock")):
        with suppress(OSError):
            if path.lstat().st_mtime < before:
                path.unlink()


def _put(built: Path, library: Path, key: str) -> bytes:
    """Store a library atomically and return its content."""
    content = built.read_bytes()
    with built.open("ab") as file:
        file.write(_digest(key, content))
        file.flush()
        os.fsync(file.fileno())
    built.chmod(0o600)
    built.replace(library)
    return content


def _key(source: Source, compiler: Compiler) -> str:
    """Return a key of everything that affects the library: sources, compiler and processor."""
    inputs = (_FORMAT, *compiler.command, compiler.identity, *FLAGS, cpu())
    inputs = (*inputs, source.text, *source.units)
    return hashlib.sha256("\0".join(inputs).encode()).hexdigest()[:40]


@contextmanager
def private() -> Iterator[Path]:
    """Provide a private temporary folder, which is removed afterwards.

    Raises:
        BuildError: The folder cannot be created or written.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="mbd_ros_", ignore_cleanup_errors=True) as name:
            yield Path(name)
    except OSError as error:
        place = error.filename or "the folder for temporary files"
        raise BuildError(f"{place}: {error.strerror or error}") from error


class Library:
    """A shared library of compiled functions.

    Args:
        source: Source of the library.
        content: Bytes of the library.
        compiler: Name of its compiler.

    Attributes:
        seconds: Duration of the compilation, now or when the library was cached [s].
        c: All functions of the library by name; a call lets other threads run.

    Raises:
        BuildError: It cannot be loaded.
    """

    def __init__(self, source: Source, content: bytes, compiler: str) -> None:
        self.source = source
        self.compiler = compiler
        self.c = _load(content)
        self.seconds = float(content[-_SECONDS:])
        self._quick = ctypes.PyDLL(self.c._name, handle=self.c._handle)

    def function(self, name: str) -> NativeFunction:
        """Return a function of the source, with argument and result arrays of its own.

        Args:
            name: Name of the function in the source.
        """
        native = self.entry(f"call_{name}")
        return NativeFunction(native, self.source.signatures[name], self.source.lanes)

    def entry(self, name: str) -> ctypes._CFuncPtr:
        """Return a C function that takes one address; a call holds the interpreter lock."""
        native = self._quick[name]
        native.argtypes, native.restype = (ctypes.c_void_p,), None
        return native


def _load(content: bytes) -> ctypes.CDLL:
    """Load a library from a place that no other user can change."""
    places = [_in_memory, _in_a_file] if hasattr(os, "memfd_create") else [_in_a_file]
    for place in places:
        with place(content) as path:
            try:
                return ctypes.CDLL(path)
            except OSError as error:  # some systems do not execute files in memory
                why = error
    raise BuildError(f"the compiled library cannot be loaded: {why}")


@contextmanager
def _in_memory(content: bytes) -> Iterator[str]:
    """Provide the path of a file in memory."""
    file = os.memfd_create("mbd_ros")
    try:
        with open(file, "wb", closefd=False) as written:
            written.write(content)
        yield f"/proc/self/fd{_unique_separator()}/{file}"
    finally:
        os.close(file)


def _unique_separator() -> str:
    """Return a new spelling of / each time, since the linker identifies files by path."""
    return "".join("//." if bit == "1" else "/." for bit in f"{next(_loaded):b}")


@contextmanager
def _in_a_file(content: bytes) -> Iterator[str]:
    with private() as folder:
        path = folder / "scene.so"
        path.write_bytes(content)
        yield str(path)


class NativeFunction:
    """A compiled function with arrays of its own: write `arguments`, call it, read `results`.

    Attributes:
        arguments: One array for each argument, shape (size,), or (size, lanes) in lanes.
        results: One array for each result, shape (size,), or (size, lanes) in lanes.
    """

    def __init__(self, function: ctypes._CFuncPtr, signature: Signature, lanes: int) -> None:
        self.arguments = tuple(aligned(size, lanes) for size in signature.arguments)
        self.results = tuple(aligned(size, lanes) for size in signature.results)
        self._work = aligned(signature.work, lanes)
        arrays = (*self.arguments, *self.results, self._work)
        self._at = (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        self._address = ctypes.addressof(self._at)
        self._function = function

    def __call__(self) -> None:
        """Compute the results."""
        self._function(self._address)


def aligned(size: int, lanes: int = 1) -> Array:
    """Return aligned zeros, shape (size,), or (size, lanes) for several lanes."""
    buffer = np.zeros(size * lanes + _ALIGNED // 8)
    first = -buffer.ctypes.data % _ALIGNED // 8
    values = buffer[first : first + size * lanes]
    return values if lanes == 1 else values.reshape(size, lanes)
