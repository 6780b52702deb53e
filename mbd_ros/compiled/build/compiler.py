"""The C compiler of this machine: runs of it end with this process."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from mbd_ros.errors import MbdError

LONGEST = 900.0  # s that compilers may take
_LOOK = 0.005  # s
_LINES = 10  # of what a compiler says
NAMES = ("cc", "gcc", "clang")
OPTIMIZE = ("-O2", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")
WIDTH = ("-mprefer-vector-width=512",) if platform.machine() == "x86_64" else ()
FLAGS = ("-std=gnu11", *OPTIMIZE, *WIDTH, "-fPIC", "-fvisibility=hidden", "-w")
_OF_A_CPU = {
    *("vendor_id", "cpu family", "model", "model name", "stepping", "flags", "Features"),
    *("CPU implementer", "CPU architecture", "CPU variant", "CPU part", "CPU revision"),
}


class Compiler(NamedTuple):
    """A C compiler.

    Attributes:
        identity: What tells it from other versions of it.
    """

    words: tuple[str, ...]
    identity: str

    @property
    def name(self) -> str:
        """The command as people write it."""
        return shlex.join(self.words)

    def build(self, texts: Sequence[str], folder: Path) -> Path:
        """A shared library of C sources, which are compiled side by side on the cores there are.

        Args:
            folder: Where it may write.

        Raises:
            BuildError: The compiler fails or does not end.
            OSError: The folder cannot be written.
        """
        library = folder / "scene.so"
        sources = [folder / f"scene_{k}.c" for k in range(len(texts))]
        for source, text in zip(sources, texts, strict=True):
            source.write_text(text, encoding="utf-8")
        link = (*self.words, *FLAGS, "-shared", "-o", str(library))
        if len(sources) > 1:
            objects = [source.with_suffix(".o") for source in sources]
            pairs = zip(objects, sources, strict=True)
            each = [(*self.words, *FLAGS, "-c", "-o", str(o), str(source)) for o, source in pairs]
            run_all(self.name, each, folder)
            sources = objects
        run_all(self.name, [(*link, *map(str, sources), "-lm")], folder)
        if not library.is_file():
            raise BuildError(f"{self.name} ended without an error and wrote nothing")
        return library


class BuildError(MbdError):
    """Code that cannot be compiled or loaded: says by which program, where, and why not."""


def find_compiler() -> Compiler:
    """The compiler that the variable CC names, else the first of cc, gcc, clang and ziglang.

    Raises:
        BuildError: There is none, or none of the name in CC.
    """
    named = shlex.split(os.environ.get("CC", ""))
    for words in [named] if named else [[name] for name in NAMES]:
        found = shutil.which(words[0])
        if found:
            return Compiler((found, *words[1:]), _identity(Path(found)))
    if named:
        raise BuildError(f"the variable CC names {named[0]!r}, which is no program here")
    zig = find_spec("ziglang")
    if zig is not None and zig.origin is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"), _identity(Path(zig.origin)))
    raise BuildError(
        f"no C compiler found: none of {', '.join(NAMES)} on the PATH. Install one "
        "(apt install gcc), or: pip install 'mbd_ros[ziglang]'"
    )


def _identity(program: Path) -> str:
    """Changes when the program is installed anew."""
    real = program.resolve()
    status = real.stat()
    return f"{real} {status.st_size} {status.st_mtime_ns}"


def run_all(name: str, commands: Sequence[Sequence[str]], folder: Path) -> None:
    """Runs commands to their ends, as many at a time as there are cores.

    Args:
        name: What they are called in errors.
        folder: For their temporary files.

    Raises:
        BuildError: One fails, does not start or does not end; the others are ended.
        OSError: The folder cannot be written.
    """
    waiting, running = list(commands), list[Started]()
    end = time.monotonic() + LONGEST
    try:
        while waiting or running:
            while waiting and len(running) < cores():
                running.append(_started(name, waiting.pop(0), folder))
            time.sleep(_LOOK)
            for one in [one for one in running if one.child.poll() is not None]:
                running.remove(one)
                _check(name, one)
            if time.monotonic() > end:
                raise BuildError(f"{name} did not end within {LONGEST:g} s")
    finally:
        for one in running:
            os.killpg(one.child.pid, signal.SIGKILL)
            one.child.wait()


class Started(NamedTuple):
    """A program and what it says."""

    child: subprocess.Popen[bytes]
    said: Path


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _started(name: str, words: Sequence[str], folder: Path) -> Started:
    """A program in a group of its own, whose children end with it."""
    handle, said = tempfile.mkstemp(suffix=".txt", dir=folder)
    try:
        child = subprocess.Popen(
            words,
            env={**os.environ, "TMPDIR": str(folder), "LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            stdout=handle,
            stderr=handle,
            start_new_session=True,
        )
    except OSError as error:
        raise BuildError(f"{name} does not start: {error.strerror}") from error
    finally:
        os.close(handle)
    return Started(child, Path(said))


def _check(name: str, one: Started) -> None:
    """Whether a program that ended did what it should.

    Raises:
        BuildError: It failed: with the first lines of what it said.
    """
    code = one.child.returncode
    if code:
        lines = one.said.read_text(errors="replace").strip().splitlines()
        ended = f"ended with exit code {code}" if code > 0 else f"was ended by signal {-code}"
        raise BuildError("\n".join([f"{name} {ended}", *lines[:_LINES]]))


def cpu() -> str:
    """What tells this kind of processor from others, its instruction sets among it."""
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n", 1)[0]
    except OSError:
        first = ""
    lines = [line.partition(":") for line in first.splitlines()]
    told = [
        f"{name.strip()}={value.strip()}" for name, _, value in lines if name.strip() in _OF_A_CPU
    ]
    return "\n".join([platform.system(), platform.machine(), *(told or [platform.processor()])])


def lanes() -> int:
    """How many doubles a vector of this processor holds."""
    words = set(cpu().replace("=", " ").split())
    return 8 if "avx512f" in words else 4 if "avx2" in words else 2
