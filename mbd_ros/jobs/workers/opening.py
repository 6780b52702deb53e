"""Workers: processes of this machine, or of a Dask cluster."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from mbd_ros.compiled.build.side_by_side import cores
from mbd_ros.jobs.workers.task import Result, Task


class Workers(Protocol):
    """Contract of workers, which do tasks."""

    @property
    def count(self) -> int:
        """How many tasks they do at the same time."""
        ...

    def cpu(self) -> str:
        """Processor on which tasks that want to be alone are done."""
        ...

    def run(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Result]]:
        """Every task with its result, in the order in which they end; one at a time if alone."""
        ...


def do_all(workers: Workers, tasks: Sequence[Task]) -> Iterator[tuple[Task, Result]]:
    """Tasks that want to be alone come first, then the others, long ones before short ones."""
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
        from mbd_ros.jobs.workers.cluster import Cluster

        return Cluster(scheduler)
    from mbd_ros.jobs.workers.processes import Processes

    return Processes(count or cores())
