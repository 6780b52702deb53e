"""Nodes that start at once: forks of an interpreter that has imported what nodes import.

`python warm_start.py FD` is that interpreter. Importing takes most of the start of a node; all
that a node does by itself comes after the fork: arguments, parameters, rcl, DDS. What starts by an
executable of the package (test_programs, test_launch) imports for itself.
"""

import array
import ctypes
import faulthandler
import functools
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from io import TextIOWrapper

_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of linux/prctl.h
_LARGEST = 1 << 20  # bytes of a request
_PRELOADED = ("rclpy.experimental", "mbd_ros.scene.reader", "mbd_ros.nodes.shell.process")


class WarmProcess:
    """A started node, with what the tests use of `subprocess.Popen`."""

    def __init__(self, pid: int, stderr: TextIOWrapper) -> None:
        self.pid, self.stderr = pid, stderr
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Exit code, None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Exit code, once it has ended.

        Raises:
            subprocess.TimeoutExpired: It has not, within `timeout` [s].
        """
        end = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            time.sleep(0.002)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


class WarmStart:
    """The interpreter from which nodes are forked; it ends with its end of the socket."""

    def __init__(self, root: str) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)  # so that nodes are children of this one
        self._process = subprocess.Popen(
            [sys.executable, __file__, str(theirs.fileno())],
            env={**os.environ, "PYTHONPATH": root},
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
        )
        theirs.close()

    def start(self, words: Sequence[str], environment: Mapping[str, str]) -> WarmProcess:
        """`python words..`, for words that begin with -m or with a script."""
        ours, theirs = os.pipe()
        request = {"words": list(words), "environment": dict(environment), "folder": os.getcwd()}
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [theirs]))]
        self._socket.sendmsg([json.dumps(request).encode()], rights)
        os.close(theirs)
        pid = int(self._socket.recv(100))
        return WarmProcess(pid, os.fdopen(ours, encoding="utf-8", errors="replace"))


@functools.cache
def warm_start(root: str) -> WarmStart:
    """The one interpreter of this process; `root` is the folder of the packages."""
    return WarmStart(root)


def can_start(words: Sequence[str]) -> bool:
    """Whether a fork can do what `python words..` does."""
    return words[0] == "-m" or words[0].endswith(".py")


def _serve(server: socket.socket) -> dict[str, object] | None:
    """Fork for every request; returns in the fork, with its request, or at the end, with None."""
    while True:
        request, rights, _, _ = server.recvmsg(_LARGEST, socket.CMSG_SPACE(4))
        if not request:
            return None
        (stderr,) = array.array("i", rights[0][2])
        read, write = os.pipe()
        between = os.fork()
        if between == 0:
            pid = os.fork()
            if pid:  # its parent ends, so that the tests become its parent
                os.write(write, str(pid).encode())
                os._exit(0)
            os.close(read)
            os.close(write)
            os.dup2(stderr, 2)
            os.close(stderr)
            server.close()
            return json.loads(request)
        os.close(stderr)
        os.close(write)
        os.waitpid(between, 0)
        server.send(os.read(read, 100))
        os.close(read)


def _become(words: list[str], environment: dict[str, str], folder: str, path: list[str]) -> None:
    """Run as `python words..` would in an environment and a folder."""
    faulthandler.enable()  # on the pipe that is stderr now
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    given = [part for part in environment.get("PYTHONPATH", "").split(os.pathsep) if part]
    if words[0] == "-m":
        sys.argv, sys.path[:] = words[1:], [folder, *given, *path]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv, sys.path[:] = words, [os.path.dirname(words[0]), *given, *path]
        runpy.run_path(words[0], run_name="__main__")


def _main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all
    own = [os.path.dirname(os.path.abspath(__file__)), os.environ["PYTHONPATH"]]
    path = [part for part in sys.path if part not in own]
    for name in _PRELOADED:
        import_module(name)
    from mbd_ros.nodes.table import NODES

    for target in NODES.values():
        import_module(target.partition(":")[0])
    request = _serve(socket.socket(fileno=int(sys.argv[1])))
    if request is not None:
        _become(**request, path=path)


if __name__ == "__main__":
    _main()
