"""A node of the tests, in a process of its own."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import crashes
from deadline import DEADLINE
from nodes.warm_start import can_start, warm_start
from places import ROOT

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
_COMPUTING = 0.3  # s


class NodeProcess:
    """A node in a process of its own; what it logs is collected while it runs.

    Attributes:
        command: Arguments of the process.
        started: All nodes that the tests have started and not judged yet.
    """

    started: ClassVar[list["NodeProcess"]] = []

    def __init__(self, command: Sequence[str], domain: int) -> None:
        self.command = list(command)
        path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH")) if p)
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "PYTHONPATH": path,
        }
        del environment[PROFILES]
        self.process: Any
        if command[0] == sys.executable and can_start(command[1:]):
            self.process = warm_start(str(ROOT)).start(command[1:], environment)
        else:
            self.process = subprocess.Popen(
                command,
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
        self._lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.started.append(self)

    @property
    def pid(self) -> int:
        """Process id."""
        return self.process.pid

    @property
    def log(self) -> str:
        """Everything written to stderr until now."""
        return "".join(self._lines)

    def wait_for(self, text: str) -> None:
        """Return when `text` was logged.

        Raises:
            AssertionError: It was not, within `DEADLINE` or the life of the process.
        """
        end = time.monotonic() + DEADLINE
        while text not in self.log:
            if self.process.poll() is not None:
                self._reader.join(DEADLINE)
                end = 0.0
            elif time.monotonic() < end:
                time.sleep(0.01)
                continue
            assert text in self.log, f"never logged {text!r}:\n{self.log}"

    def count_logged(self, text: str) -> int:
        """Return how often `text` was logged, after waiting for the first time."""
        self.wait_for(text)
        return self.log.count(text)

    def wait(self) -> int:
        """Exit code, once the process has ended by itself.

        Raises:
            AssertionError: It has not, within `DEADLINE`.
        """
        try:
            code = self.process.wait(DEADLINE)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"never ended:\n{self.log}") from None
        self._reader.join(DEADLINE)
        return code

    def stop(self, number: int = signal.SIGINT) -> int:
        """Exit code after a signal."""
        self.process.send_signal(number)
        return self.wait()

    def crash(self) -> str:
        """Where the evidence of a crash is, and what it says; empty if the node did not crash."""
        code = self.process.poll()
        if code is None or -code not in crashes.SIGNALS:
            return ""
        self._reader.join(DEADLINE)
        test = os.environ.get("PYTEST_CURRENT_TEST", "")
        head = f"{signal.Signals(-code).name} in {test}: {' '.join(self.command)}"
        path = crashes.report(f"node-{self.pid}", f"{head}\n{self.log}")
        return f"{path}: {head}\n{self.log}"

    def cpu_seconds(self) -> float:
        """User and system time used so far [s]."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def is_idle(self) -> bool:
        """Return whether the node mostly waits.

        This thread computes meanwhile. A node that never waits gets as much CPU time, however many
        others run on the machine. One that waits has 1 to 10 % of it; 40 % were seen on two cores
        beside 20 busy processes, where timers fire often during so much computing.
        """
        begin, end = self.cpu_seconds(), time.thread_time() + _COMPUTING
        while time.thread_time() < end:
            pass
        return self.cpu_seconds() - begin < 0.7 * _COMPUTING

    def _read(self) -> None:
        assert self.process.stderr is not None
        self._lines.extend(self.process.stderr)
