"""Work that may be done anywhere: in processes of this machine, or of a Dask cluster."""

import importlib
import json
import math
import os
import platform
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol


class Task(NamedTuple):
    """A call of one function, independent of all others.

    Attributes:
        name: For whoever watches.
        call: `module:function` of one argument.
        argument: What it is called with; whatever JSON holds.
        seconds: About how long it takes.
        alone: It times something: nothing else of the same run may stand beside it.
        limit: A process of this machine that needs longer is ended [s].
    """

    name: str
    call: str
    argument: Mapping[str, Any]
    seconds: float = 1.0
    alone: bool = False
    limit: float = math.inf


class Result(NamedTuple):
    """What came of a task.

    Attributes:
        value: What the function returned, as JSON gives it back.
        failure: Why there is no value; empty where there is one.
        seconds: How long it took [s].
        cpu: The processor it ran on.
    """

    value: Any = None
    failure: str = ""
    seconds: float = 0.0
    cpu: str = ""


class Workers(Protocol):
    """Those who do tasks."""

    @property
    def count(self) -> int:
        """How many tasks they do at the same time."""
        ...

    def run(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Result]]:
        """Every task with its result, in the order in which they end; one at a time if alone."""
        ...


def do(task: Task) -> Result:
    """Do a task here; whatever goes wrong is in the result."""
    begin = time.perf_counter()
    module, _, function = task.call.partition(":")
    try:
        value = getattr(importlib.import_module(module), function)(task.argument)
        value = json.loads(json.dumps(value))  # what a stored result would give
    except Exception as error:  # noqa: BLE001 - one task must not end the others
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(frame.filename).name}:{frame.lineno}"
        return Result(failure=f"{type(error).__name__}: {error} ({where})", cpu=cpu())
    return Result(value, seconds=time.perf_counter() - begin, cpu=cpu())


def do_all(workers: Workers, tasks: Sequence[Task]) -> Iterator[tuple[Task, Result]]:
    """Those that want to be alone first, then the others, long ones before short ones."""
    yield from workers.run([task for task in tasks if task.alone], alone=True)
    others = [task for task in tasks if not task.alone]
    yield from workers.run(sorted(others, key=lambda task: -task.seconds), alone=False)


def open_workers(scheduler: str | None, count: int | None) -> AbstractContextManager[Workers]:
    """Workers for the length of a `with` block.

    Args:
        scheduler: Address of a Dask scheduler, `local:N`, or None for processes of this machine.
        count: How many processes; None for one a core.

    Raises:
        DataError: Dask is missing, or nobody answers at that address.
    """
    if scheduler is not None:
        from mbd_ros.cluster import Cluster

        return Cluster(scheduler)
    from mbd_ros.processes import Processes

    return Processes(count or cores())


def cores() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def cpu() -> str:
    """Name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
