"""The C compiler of this machine."""

import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from mbd_ros.errors import MbdError

NAMES = ("cc", "gcc", "clang")
OPTIMIZE = ("-O2", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")
FLAGS = ("-std=gnu11", *OPTIMIZE, "-fPIC", "-shared", "-fvisibility=hidden", "-w")
LONGEST = 900.0  # s that a compiler may take
_OF_A_CPU = {
    *("vendor_id", "cpu family", "model", "model name", "stepping", "flags", "Features"),
    *("CPU implementer", "CPU architecture", "CPU variant", "CPU part", "CPU revision"),
}


class BuildError(MbdError):
    """Code that cannot be compiled or loaded: says by which program, where, and why not."""


class Compiler(NamedTuple):
    """A C compiler.

    Attributes:
        words: The command.
        identity: What tells it from other versions of it.
    """

    words: tuple[str, ...]
    identity: str

    @property
    def name(self) -> str:
        """The command as people write it."""
        return shlex.join(self.words)

    def build(self, text: str, folder: Path) -> Path:
        """A shared library of C source.

        Args:
            text: The source.
            folder: Where it may write.

        Raises:
            BuildError: The compiler fails or does not end.
            OSError: The folder cannot be written.
        """
        source, library = folder / "scene.c", folder / "scene.so"
        source.write_text(text, encoding="utf-8")
        environment = {**os.environ, "TMPDIR": str(folder), "LC_ALL": "C"}
        _run((*self.words, *FLAGS, "-o", str(library), str(source), "-lm"), environment)
        if not library.is_file():
            raise BuildError(f"{self.name} ended without an error and wrote nothing")
        return library


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


def _identity(program: Path) -> str:
    """Changes when the program is installed anew."""
    real = program.resolve()
    status = real.stat()
    return f"{real} {status.st_size} {status.st_mtime_ns}"


def _run(words: tuple[str, ...], environment: dict[str, str]) -> None:
    """A compiler, to its end; its children end with it.

    Raises:
        BuildError: It fails, does not start or does not end.
    """
    try:
        child = subprocess.Popen(
            words,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        raise BuildError(f"{words[0]} does not start: {error.strerror}") from error
    with child:
        try:
            said, _ = child.communicate(timeout=LONGEST)
        except subprocess.TimeoutExpired as error:
            raise BuildError(f"{words[0]} did not end within {LONGEST:g} s") from error
        finally:
            if child.returncode is None:
                os.killpg(child.pid, signal.SIGKILL)
    if child.returncode:
        lines = said.decode(errors="replace").strip().splitlines()
        ended = f"ended with exit code {child.returncode}"
        if child.returncode < 0:
            ended = f"was ended by signal {-child.returncode}"
        raise BuildError("\n".join([f"{shlex.join(words[:-4])} {ended}", *lines[:10]]))
