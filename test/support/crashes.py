"""Evidence of processes that die of a signal: their stack and log, under build/crashes/.

Processes of pytest write their stacks there by `faulthandler`; programs that tests start write
them to stderr, since PYTHONFAULTHANDLER is set for all of them.
"""

import faulthandler
import os
import signal
from pathlib import Path

import pytest
from deadline import DEADLINE
from places import ROOT

FOLDER = ROOT / "build" / "crashes"
SIGNALS = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL)
_stack = pytest.StashKey()


def report(name: str, text: str) -> Path:
    """Write what is known of a crash; its path."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / f"{name}.txt"
    path.write_text(text)
    return path


@pytest.hookimpl(trylast=True)  # after the plugin of pytest, which writes to stderr
def pytest_configure(config):
    """Let a crash of this process write its stack into a file of its own."""
    os.environ["PYTHONFAULTHANDLER"] = "1"
    FOLDER.mkdir(parents=True, exist_ok=True)
    name = _of_worker(config.workerinput) if hasattr(config, "workerinput") else f"{os.getpid()}"
    config.stash[_stack] = (FOLDER / f"pytest-{name}.txt").open("w")
    faulthandler.enable(config.stash[_stack])
    # An executor of rclpy turns it to stderr, which is captured and lost with the process.
    faulthandler.enable = lambda *_, **__: None


def pytest_unconfigure(config):
    """Nothing crashed: remove the file."""
    if (file := config.stash.get(_stack, None)) is not None:
        faulthandler.disable()
        file.close()
        Path(file.name).unlink(missing_ok=True)


@pytest.hookimpl(optionalhook=True)
def pytest_handlecrashitem(crashitem, report):
    """Say in the report of a test whose worker died where its stack is, and show it."""
    path = FOLDER / f"pytest-{_of_worker(report.node.workerinput)}.txt"
    process = getattr(report.node.gateway._io, "popen", None)
    code = None if process is None else process.wait(DEADLINE)
    with path.open("a") as file:
        file.write(f"\nexit code {code} in {crashitem}\n")
    report.longrepr = f"{report.longrepr}\n{path}:\n{path.read_text()}"


def _of_worker(workerinput):
    return f"{workerinput['workerid']}-{workerinput['testrunuid']}"
