"""A task that any process or machine may run, and its result."""

from __future__ import annotations

import base64
import importlib
import json
import math
import platform
import time
import traceback
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array


class Task(NamedTuple):
    """A call of one function, independent of all others.

    Attributes:
        name: Name for messages.
        call: Function of one argument, as `module:function`.
        argument: Argument of the function; any value that JSON holds.
        seconds: Expected duration [s].
        alone: Whether nothing else may run beside it, since it measures times.
        limit: Time after which the task is abandoned [s].
    """

    name: str
    call: str
    argument: Mapping[str, Any]
    seconds: float = 1.0
    alone: bool = False
    limit: float = math.inf


class Result(NamedTuple):
    """The result of a task.

    Attributes:
        value: Return value of the function, converted to JSON and back.
        failure: Reason why there is no value; empty if there is one.
        seconds: Duration [s].
        cpu: Name of the processor that ran it.
    """

    value: Any = None
    failure: str = ""
    seconds: float = 0.0
    cpu: str = ""


def do(task: Task) -> Result:
    """Run a task in this process; a failure becomes part of the result."""
    begin = time.perf_counter()
    module, _, function = task.call.partition(":")
    try:
        value = getattr(importlib.import_module(module), function)(task.argument)
        value = json.loads(json.dumps(value))  # as a stored result would be read
    except Exception as error:  # noqa: BLE001 - one task must not end the others
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(frame.filename).name}:{frame.lineno}"
        return Result(failure=f"{type(error).__name__}: {error} ({where})", cpu=cpu())
    return Result(value, seconds=time.perf_counter() - begin, cpu=cpu())


@cache
def cpu() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def pack(values: Array) -> list[Any]:
    """Return an array of numbers as its shape and a text."""
    data = np.ascontiguousarray(values, dtype="<f8").tobytes()
    return [list(values.shape), base64.b64encode(data).decode()]


def unpack(packed: Sequence[Any]) -> Array:
    """Return the array that `pack` has packed."""
    shape, data = packed
    return np.frombuffer(base64.b64decode(data), dtype="<f8").reshape(shape).copy()


def nothing(_: Mapping[str, Any]) -> None:
    """Do nothing; the result then names the processor of a worker."""
