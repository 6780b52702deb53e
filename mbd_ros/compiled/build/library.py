"""Native code in this process."""

import ctypes
import hashlib
import itertools
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mbd_ros.compiled.build import cache
from mbd_ros.compiled.build.aligned import aligned
from mbd_ros.compiled.build.compiler import FLAGS, BuildError, Compiler, cpu, find_compiler
from mbd_ros.compiled.code.source import Signature, Source

_SECONDS = 12  # characters
_FORMAT = "the library, then the seconds that it took"
_loaded = itertools.count(1)


def _silent(line: str) -> None:
    """Says nothing."""


def _trusted(library: "Library") -> None:
    """Refuses nothing."""


Check = Callable[["Library"], None]


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


class Library:
    """A shared library of compiled functions.

    Args:
        source: What it was compiled from.
        content: The library.
        compiler: What compiled it.

    Attributes:
        source: As given.
        compiler: As given.
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


def load(source: Source, say: cache.Say = _silent, check: Check = _trusted) -> Library:
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
            content = cache.kept(_key(source, compiler), build, say, again=again)
            library = Library(source, content, compiler.name)
        except (OSError, BuildError) as error:
            with cache.private() as folder:
                library = Library(source, build(folder).read_bytes(), compiler.name)
            say(f"not kept: {str(error).splitlines()[0]}")
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


def _key(source: Source, compiler: Compiler) -> str:
    """Another one for all that makes another library: the text holds model, parts and numbers."""
    told = (_FORMAT, *compiler.words, compiler.identity, *FLAGS, cpu())
    told = (*told, source.text, *source.units)
    return hashlib.sha256("\0".join(told).encode()).hexdigest()[:40]


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
    with cache.private() as folder:
        path = folder / "scene.so"
        path.write_bytes(content)
        yield str(path)
