"""The C compiler of this machine; its processes end with this one."""

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

LONGEST = 900.0  # time limit of a compilation [s]
_POLL = 0.005  # s
_LINES = 10  # of compiler output in a message
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
        command: Command and arguments that start it.
        identity: String that differs between versions of the compiler.
    """

    command: tuple[str, ...]
    identity: str

    @property
    def name(self) -> str:
        """The command as a line of a shell."""
        return shlex.join(self.command)

    def build(self, texts: Sequence[str], folder: Path) -> Path:
        """Build a shared library from C sources, which are compiled in parallel.

        Args:
            texts: The sources.
            folder: Folder for all files.

        Raises:
            BuildError: The compiler fails or does not end.
            OSError: The folder cannot be written.
        """
        library = folder / "scene.so"
        sources = [folder / f"scene_{k}.c" for k in range(len(texts))]
        for source, text in zip(sources, texts, strict=True):
            source.write_text(text, encoding="utf-8")
        link = (*self.command, *FLAGS, "-shared", "-o", str(library))
        if len(sources) > 1:
            objects = [source.with_suffix(".o") for source in sources]
            pairs = zip(objects, sources, strict=True)
            commands = [
                (*self.command, *FLAGS, "-c", "-o", str(o), str(source)) for o, source in pairs
            ]
            run_all(self.name, commands, folder)
            sources = objects
        run_all(self.name, [(*link, *map(str, sources), "-lm")], folder)
        if not library.is_file():
            raise BuildError(f"{self.name} ended without an error but wrote no library")
        return library


class BuildError(MbdError):
    """Code cannot be compiled or loaded; the message names program, place and reason."""


def find_compiler() -> Compiler:
    """Return the compiler in the variable CC, or else the first of cc, gcc, clang and ziglang.

    Raises:
        BuildError: There is no compiler, or CC names none.
    """
    named = shlex.split(os.environ.get("CC", ""))
    for command in [named] if named else [[name] for name in NAMES]:
        program = shutil.which(command[0])
        if program:
            return Compiler((program, *command[1:]), _identity(Path(program)))
    if named:
        raise BuildError(
            f"the variable CC names {named[0]!r}, which is not a program on this machine"
        )
    zig = find_spec("ziglang")
    if zig is not None and zig.origin is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"), _identity(Path(zig.origin)))
    raise BuildError(
        f"no C compiler found: none of {', '.join(NAMES)} on the PATH. Install one "
        "(apt install gcc), or: pip install 'mbd_ros[ziglang]'"
    )


def _identity(program: Path) -> str:
    """Return a string that changes when the program is installed again."""
    real = program.resolve()
    status = real.stat()
    return f"{real} {status.st_size} {status.st_mtime_ns}"


def run_all(name: str, commands: Sequence[Sequence[str]], folder: Path) -> None:
    """Run commands to their end, as many at a time as there are cores.

    Args:
        name: Name of the program for errors.
        commands: The commands.
        folder: Folder for temporary files.

    Raises:
        BuildError: A command fails, does not start or exceeds the time limit; all others are
            terminated.
        OSError: The folder cannot be written.
    """
    waiting, running = list(commands), list[StartedProgram]()
    end = time.monotonic() + LONGEST
    try:
        while waiting or running:
            while waiting and len(running) < cores():
                running.append(_start(name, waiting.pop(0), folder))
            time.sleep(_POLL)
            for program in [p for p in running if p.child.poll() is not None]:
                running.remove(program)
                _check(name, program)
            if time.monotonic() > end:
                raise BuildError(f"{name} did not end within {LONGEST:g} s")
    finally:
        for program in running:
            os.killpg(program.child.pid, signal.SIGKILL)
            program.child.wait()


class StartedProgram(NamedTuple):
    """A running program and the file of its output."""

    child: subprocess.Popen[bytes]
    output: Path


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _start(name: str, command: Sequence[str], folder: Path) -> StartedProgram:
    """Start a program in a process group of its own, so that its children end with it."""
    handle, output = tempfile.mkstemp(suffix=".txt", dir=folder)
    try:
        child = subprocess.Popen(
            command,
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
    return StartedProgram(child, Path(output))


def _check(name: str, program: StartedProgram) -> None:
    """Check that a program ended successfully.

    Raises:
        BuildError: It failed; the message has the first lines of its output.
    """
    code = program.child.returncode
    if code:
        lines = program.output.read_text(errors="replace").strip().splitlines()
        ended = f"ended with exit code {code}" if code > 0 else f"was ended by signal {-code}"
        raise BuildError("\n".join([f"{name} {ended}", *lines[:_LINES]]))


def cpu() -> str:
    """Return a description of this kind of processor, including its instruction sets."""
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n", 1)[0]
    except OSError:
        first = ""
    lines = [line.partition(":") for line in first.splitlines()]
    properties = [
        f"{name.strip()}={value.strip()}" for name, _, value in lines if name.strip() in _OF_A_CPU
    ]
    return "\n".join(
        [platform.system(), platform.machine(), *(properties or [platform.processor()])]
    )


def lanes() -> int:
    """Return the number of doubles in a vector register of this processor."""
    flags = set(cpu().replace("=", " ").split())
    return 8 if "avx512f" in flags else 4 if "avx2" in flags else 2
