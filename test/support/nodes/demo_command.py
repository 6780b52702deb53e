"""`mbd-ros demo` as a process."""

import os
import subprocess
import sys

from places import ROOT


def command(*words):
    """`mbd-ros demo` with words, and its environment."""
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH")) if p)
    line = [sys.executable, "-m", "mbd_ros.cli", "demo", *map(str, words)]
    return line, {**os.environ, "PYTHONPATH": path}


def demo(*words, code=0):
    """What a demo prints on stdout, once it has ended with `code`."""
    line, environment = command(*words)
    ran = subprocess.run(line, env=environment, capture_output=True, text=True)
    assert ran.returncode == code, ran.stdout + ran.stderr
    assert ran.stderr == ""  # no progress where there is no terminal
    return ran.stdout
