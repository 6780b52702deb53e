"""Workers that run tasks, on this machine or a Dask cluster, and the time that they still need."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from mbd_ros.compiled.build.compiler import cores
from mbd_ros.jobs.workers.task import Result, Task

_PRIOR = 5.0  # s; weight of the expectation against what was measured


def open_workers(scheduler: str | None, count: int | None) -> AbstractContextManager[Workers]:
    """Return workers for the length of a `with` block.

    Args:
        scheduler: Address of a Dask scheduler, `local:N`, or None for processes of this machine.
        count: Number of processes; None for one per core.

    Raises:
        DataError: Dask is missing, or no scheduler answers at that address.
    """
    if scheduler is not None:
        from mbd_ros.jobs.workers.cluster import Cluster

        return Cluster(scheduler)
    from mbd_ros.jobs.workers.processes import Processes

    return Processes(count or cores())


class Workers(Protocol):
    """Contract of workers, which run tasks."""

    @property
    def count(self) -> int:
        """Number of tasks that run at the same time."""
        ...

    def cpu(self) -> str:
        """Return the processor on which tasks run that must run alone."""
        ...

    def run(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Result]]:
        """Yield every task with its result as they end; run one at a time if `alone`."""
        ...


def do_all(workers: Workers, tasks: Sequence[Task]) -> Iterator[tuple[Task, Result]]:
    """Run tasks: first those that must run alone, then the others, long ones before short ones."""
    yield from workers.run([task for task in tasks if task.alone], alone=True)
    others = [task for task in tasks if not task.alone]
    yield from workers.run(sorted(others, key=lambda task: -task.seconds), alone=False)


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declare the processes or the cluster that do the work."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Address of a Dask cluster, such as tcp://host:8786; or local:N.",
    )
    where.add_argument(
        "--workers", type=_count, metavar="N", help="Number of processes. By default one per core."
    )


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def watched(
    done: Iterator[tuple[Task, Result]], tasks: Sequence[Task], workers: int
) -> Iterator[tuple[Task, Result]]:
    """Yield tasks with results, and show the remaining time on stderr, if that is a terminal.

    Args:
        done: Tasks with results, as they end.
        tasks: All tasks.
        workers: Number of tasks that run at the same time.
    """
    remaining = Remaining(tasks, workers)
    _show(f"0 of {len(tasks)}")
    try:
        for count, (task, result) in enumerate(done, start=1):
            remaining.count(task, result)
            _show("")  # the caller may print
            yield task, result
            left = f"about {duration_text(remaining.seconds)} left"
            percent = 100 * count // len(tasks)
            _show(f"{percent} %, {count} of {len(tasks)}, {left}, last {task.name}")
    finally:
        _show("")


def _show(line: str) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{line[:100]}")
        sys.stderr.flush()


class Remaining:
    """Estimate of the remaining time, corrected by the durations of finished tasks.

    Args:
        workers: Number of tasks that run at the same time.
    """

    def __init__(self, tasks: Sequence[Task], workers: int) -> None:
        self._workers = max(workers, 1)
        self._left = {
            alone: sum(task.seconds for task in tasks if task.alone == alone)
            for alone in (True, False)
        }
        self._expected = _PRIOR
        self._took = _PRIOR

    @property
    def seconds(self) -> float:
        """Remaining time [s]."""
        work = self._left[True] + self._left[False] / self._workers
        return work * self._took / self._expected

    def count(self, task: Task, result: Result) -> None:
        """Count a task as finished."""
        self._left[task.alone] -= task.seconds
        if not result.failure:
            self._expected += task.seconds
            self._took += result.seconds


def duration_text(seconds: float) -> str:
    """Return a duration in seconds, minutes or hours, such as 12 min."""
    if seconds < 90:
        return f"{max(seconds, 0.0):.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
