"""Compilers that run at the same time, and end with this process."""

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mbd_ros.errors import MbdError

LONGEST = 900.0  # s that compilers may take
_LOOK = 0.005  # s
_LINES = 10  # of what a compiler says


class BuildError(MbdError):
    """Code that cannot be compiled or loaded: says by which program, where, and why not."""


class Started(NamedTuple):
    """A program and what it says."""

    child: subprocess.Popen[bytes]
    said: Path


def run_all(name: str, commands: Sequence[Sequence[str]], folder: Path) -> None:
    """Runs commands to their ends, as many at a time as there are cores.

    Args:
        name: What they are called in errors.
        commands: The commands.
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
