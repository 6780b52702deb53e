"""Native code in this process."""

import ctypes
import hashlib
import time
from pathlib import Path

import numpy as np

from mbd_ros.compiled.build import cache
from mbd_ros.compiled.build.compiler import FLAGS, BuildError, Compiler, cpu, find_compiler
from mbd_ros.compiled.code.emit import Signature, Source
from mbd_ros.core.state import Array

_ALIGNED = 64  # bytes, of the widest vectors


class NativeFunction:
    """A compiled function on arrays of its own.

    Write into `arguments`, call, read `results`.

    Attributes:
        arguments: One array an argument, shape (size,); (size, lanes) where reals are vectors.
        results: The same of the results.
    """

    def __init__(self, function: ctypes._CFuncPtr, signature: Signature, lanes: int) -> None:
        self.arguments = tuple(_aligned(size, lanes) for size in signature.arguments)
        self.results = tuple(_aligned(size, lanes) for size in signature.results)
        self._work = _aligned(signature.work, lanes)
        arrays = (*self.arguments, *self.results, self._work)
        self._at = (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        self._address = ctypes.addressof(self._at)
        self._function = function

    def __call__(self) -> None:
        """Computes the results."""
        self._function(self._address)


class Library:
    """A shared library of compiled functions.

    Attributes:
        source: What it was compiled from.
        c: Its other functions, by name; a call lets other threads run.
    """

    def __init__(self, source: Source, path: Path) -> None:
        try:
            self.c = ctypes.CDLL(str(path))
            self._quick = ctypes.PyDLL(str(path))
        except OSError as error:
            raise BuildError(f"{path} cannot be loaded: {error}") from error
        self.source = source

    def function(self, name: str) -> NativeFunction:
        """A function of the source, with arrays that nobody else writes to.

        Args:
            name: As CasADi calls it.
        """
        native = self._quick[f"call_{name}"]
        native.argtypes, native.restype = (ctypes.c_void_p,), None
        return NativeFunction(native, self.source.signatures[name], self.source.lanes)


def load(source: Source, say: cache.Say = lambda line: None) -> Library:
    """A library of C source, from the cache or compiled now.

    Args:
        source: The source; whole programs may stand behind the functions in its text.
        say: Is told what takes time.

    Raises:
        BuildError: There is no compiler, it fails, or what it wrote cannot be loaded.
    """
    compiler = find_compiler()

    def build(folder: Path) -> Path:
        operations = sum(source.operations.values())
        say(f"compiling {operations} operations by {compiler.words[0]}")
        start = time.perf_counter()
        built = compiler.build(source.text, folder)
        say(f"compiled in {time.perf_counter() - start:.1f} s")
        return built

    with cache.entry(_key(source, compiler), build, say) as path:
        return Library(source, path)


def _key(source: Source, compiler: Compiler) -> str:
    """Another one for all that makes another library: the text holds model, parts and numbers."""
    told = (*compiler.words, compiler.identity, *FLAGS, cpu(), source.text)
    return hashlib.sha256("\0".join(told).encode()).hexdigest()[:40]


def _aligned(size: int, lanes: int) -> Array:
    """Zeros where vectors may stand."""
    spare = _ALIGNED // 8
    room = np.zeros(size * lanes + spare)
    first = -room.ctypes.data % _ALIGNED // 8
    values = room[first : first + size * lanes]
    return values if lanes == 1 else values.reshape(size, lanes)
