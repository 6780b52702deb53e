"""The time left for many tasks, for people who watch."""

import sys
from collections.abc import Iterator, Sequence

from mbd_ros.jobs.workers.task import Result, Task

_PRIOR = 5.0  # s; weight of the expectation against what was measured


class Remaining:
    """Estimates the time left, corrected by how long the tasks so far really took.

    Args:
        tasks: All tasks.
        workers: How many tasks are done at the same time.
    """

    def __init__(self, tasks: Sequence[Task], workers: int) -> None:
        self._workers = max(workers, 1)
        self._left = {
            alone: sum(task.seconds for task in tasks if task.alone == alone)
            for alone in (True, False)
        }
        self._expected = self._took = _PRIOR

    @property
    def seconds(self) -> float:
        """Time left [s]."""
        work = self._left[True] + self._left[False] / self._workers
        return work * self._took / self._expected

    def count(self, task: Task, result: Result) -> None:
        """Take one task off."""
        self._left[task.alone] -= task.seconds
        if not result.failure:
            self._expected += task.seconds
            self._took += result.seconds


def watched(
    done: Iterator[tuple[Task, Result]], tasks: Sequence[Task], workers: int
) -> Iterator[tuple[Task, Result]]:
    """Pass results on and keep one line with the time left on stderr, if that is a terminal.

    Args:
        done: Tasks with results, as they end.
        tasks: All that will end.
        workers: How many tasks are done at the same time.

    Yields:
        What `done` yields.
    """
    remaining = Remaining(tasks, workers)
    _show(f"0 of {len(tasks)}")
    try:
        for count, (task, result) in enumerate(done, start=1):
            remaining.count(task, result)
            _show("")  # the taker may print
            yield task, result
            left = f"about {spoken(remaining.seconds)} left"
            percent = 100 * count // len(tasks)
            _show(f"{percent} %, {count} of {len(tasks)}, {left}, last {task.name}")
    finally:
        _show("")


def spoken(seconds: float) -> str:
    """A time as one says it."""
    if seconds < 90:
        return f"{max(seconds, 0.0):.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def _show(line: str) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{line[:100]}")
        sys.stderr.flush()
