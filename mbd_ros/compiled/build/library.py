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
            content = kept(_key(source, compiler), build, say, again=again)
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


def _check(folder: Path) -> None:
    """Refuse a folder that is a link, or that somebody else can write to.

    Raises:
        BuildError: It is, or somebody can.
    """
    for own in (folder.parent, folder):
        if own.is_symlink():
            raise BuildError(f"{own} is a symbolic link, which is not followed")
    status = folder.stat()
    if status.st_uid != os.geteuid():
        raise BuildError(f"{folder} belongs to another user")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise BuildError(f"{folder} can be written by others: chmod go-w {folder}")


def _intact(library: Path, key: str) -> bytes | None:
    """The library that was put in a place under this key by the user, None without."""
    try:
        with open_regular(library, follow_links=False) as file:
            status = os.fstat(file.fileno())
            content = file.read()
            with suppress(OSError):  # where nothing can be written
                os.utime(file.fileno())
    except OSError:
        return None
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    found, digest = content[:-_DIGEST], content[-_DIGEST:]
    if status.st_uid != os.geteuid() or others or digest != _digest(key, found):
        return None
    return found


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(key.encode() + content).hexdigest().encode()


@contextmanager
def _lock(path: Path, say: Say) -> Iterator[None]:
    """Waits until no other process builds the same; file systems without locks do not wait.

    Raises:
        OSError: Something else is in the place of the lock, or it cannot be made.
    """
    with suppress(FileNotFoundError):
        check_regular(path, follow_links=False)
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    with open(os.open(path, flags, 0o600), "wb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another process compiles the same: waiting for it")
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError:
            say("the cache folder has no locks: compiling without")
        yield


def _remove_unused(folder: Path) -> None:
    """Removes what nobody has loaded for long."""
    before = time.time() - _UNUSED
    for path in (*folder.glob("*.so"), *folder.glob("*.lock")):
        with suppress(OSError):
            if path.lstat().st_mtime < before:
                path.unlink()


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


def _key(source: Source, compiler: Compiler) -> str:
    """Another one for all that makes another library: the text holds model, parts and numbers."""
    told = (_FORMAT, *compiler.words, compiler.identity, *FLAGS, cpu())
    told = (*told, source.text, *source.units)
    return hashlib.sha256("\0".join(told).encode()).hexdigest()[:40]


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


class Library:
    """A shared library of compiled functions.

    Args:
        source: What it was compiled from.
        compiler: What compiled it.

    Attributes:
        seconds: How long the compiler took, now or when the library was kept [s].
        c: Its other functions, by name; a call lets other threads run.

    Raises:
        BuildError: It cannot be loaded.
    """

    def __init__(self, source: Source, content: bytes, compiler: str) -> None:
        self.source, self.compiler, self.c = source, compiler, _linked(content)
        self.seconds = float(content[-_SECONDS:])
        self._quick = ctypes.PyDLL(self.c._name, handle=self.c._handle)

    def function(self, name: str) -> NativeFunction:
        """A function of the source, with arrays that nobody else writes to.

        Args:
            name: As CasADi calls it.
        """
        native = self.entry(f"call_{name}")
        return NativeFunction(native, self.source.signatures[name], self.source.lanes)

    def entry(self, name: str) -> ctypes._CFuncPtr:
        """What takes one address and returns nothing, while no other thread runs."""
        native = self._quick[name]
        native.argtypes, native.restype = (ctypes.c_void_p,), None
        return native


def _linked(content: bytes) -> ctypes.CDLL:
    """A library in this process, from a place that nobody else can change."""
    places = [_in_memory, _in_a_file] if hasattr(os, "memfd_create") else [_in_a_file]
    for place in places:
        with place(content) as path:
            try:
                return ctypes.CDLL(path)
            except OSError as error:  # some systems execute nothing that is only in memory
                why = error
    raise BuildError(f"the compiled library cannot be loaded: {why}")


@contextmanager
def _in_memory(content: bytes) -> Iterator[str]:
    """Path of a file without a place on a disk."""
    file = os.memfd_create("mbd_ros")
    try:
        with open(file, "wb", closefd=False) as written:
            written.write(content)
        yield f"/proc/self/fd{_another()}/{file}"
    finally:
        os.close(file)


def _another() -> str:
    """Another way of writing / each time: the linker knows by its path what is loaded already."""
    return "".join("//." if bit == "1" else "/." for bit in f"{next(_loaded):b}")


@contextmanager
def _in_a_file(content: bytes) -> Iterator[str]:
    with private() as folder:
        path = folder / "scene.so"
        path.write_bytes(content)
        yield str(path)


class NativeFunction:
    """A compiled function on arrays of its own.

    Write into `arguments`, call, read `results`.

    Attributes:
        arguments: One array an argument, shape (size,); (size, lanes) where reals are vectors.
        results: The same of the results.
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
        """Computes the results."""
        self._function(self._address)


def aligned(size: int, lanes: int = 1) -> Array:
    """Zeros, shape (size,), or (size, lanes) where each is a vector of several numbers."""
    room = np.zeros(size * lanes + _ALIGNED // 8)
    first = -room.ctypes.data % _ALIGNED // 8
    values = room[first : first + size * lanes]
    return values if lanes == 1 else values.reshape(size, lanes)
