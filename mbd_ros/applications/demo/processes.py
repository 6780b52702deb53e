"""The nodes of a demo: processes that are always stopped, on a DDS domain of their own."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from mbd_ros.errors import FAILED, MbdError

_STOP_TIMEOUT = 10.0  # s
_LOG_LINES = 5  # of a node that failed, shown


class Failed(MbdError):
    """The demo ran and failed: a process died, or a number is none."""

    exit_code = FAILED


class NodeCommand(NamedTuple):
    """How a node is started.

    Attributes:
        name: Of the node, and of its module.
        parameters: Name -> value, as on a ROS command line.
        arguments: More ROS arguments.
    """

    name: str
    parameters: Mapping[str, str]
    arguments: Sequence[str] = ()


class NodeProcesses:
    """Running nodes; what they log goes to files.

    Args:
        environment: Of the processes.
        logs: Folder for the logs.
    """

    def __init__(
        self, commands: Sequence[NodeCommand], environment: Mapping[str, str], logs: Path
    ) -> None:
        self._logs = logs
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        try:
            for command in commands:
                with self._log(command.name).open("wb") as log:
                    self._running[command.name] = subprocess.Popen(
                        _words(command), env=dict(environment), stdout=log, stderr=log
                    )
        except BaseException:
            self.kill()
            raise

    def check(self) -> None:
        """Raise Failed if a node ended."""
        for name, process in self._running.items():
            if process.poll() is not None:
                self._blame(name, f"ended with exit code {process.returncode}")

    def stop(self) -> None:
        """Interrupt all nodes and wait for them.

        Raises:
            Failed: One does not stop, or reports an error.
        """
        for process in self._running.values():
            process.send_signal(signal.SIGINT)
        end = time.monotonic() + _STOP_TIMEOUT
        for name, process in self._running.items():
            try:
                code = process.wait(max(end - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                self._blame(name, f"did not stop within {_STOP_TIMEOUT:g} s")
            if code != 0:
                self._blame(name, f"ended with exit code {code}")

    def kill(self) -> None:
        """End what still runs."""
        for process in self._running.values():
            if process.poll() is None:
                process.kill()
            process.wait()

    def _log(self, name: str) -> Path:
        return self._logs / f"{name}.log"

    def _blame(self, name: str, what: str) -> None:
        text = self._log(name).read_text(encoding="utf-8", errors="replace")
        said = "\n  ".join(text.splitlines()[-_LOG_LINES:])
        raise Failed(f"node {name} {what}\n  {said}".rstrip())


@contextmanager
def running(
    commands: Sequence[NodeCommand], environment: Mapping[str, str], logs: Path
) -> Iterator[NodeProcesses]:
    """Nodes for the length of a `with` block; killed if it does not end well.

    Raises:
        Failed: A node does not stop, or reports an error.
    """
    processes = NodeProcesses(commands, environment, logs)
    try:
        yield processes
        processes.stop()
    finally:
        processes.kill()


def _words(command: NodeCommand) -> list[str]:
    parameters = [
        word for name, value in command.parameters.items() for word in ("-p", f"{name}:={value}")
    ]
    target = ["-m", "mbd_ros.nodes", command.name]
    return [sys.executable, *target, "--ros-args", *parameters, *command.arguments]
