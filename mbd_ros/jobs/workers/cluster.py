"""Tasks on a Dask cluster; the result does not depend on how many workers it has or loses."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import Any

from mbd_ros.errors import DataError
from mbd_ros.jobs.workers.task import Result, Task, do

_CONNECT, _LOOK, _DESERTED = 10.0, 5.0, 60.0  # s
_AHEAD = 3  # tasks a worker, so that none waits for the next


class Cluster:
    """Does tasks on a Dask cluster, for the length of a `with` block.

    A task whose worker is lost goes to another one; Dask gives a task up that takes four workers
    with it. Tasks that want to be alone run one at a time, all on the same host.

    Args:
        address: Of the scheduler, as `tcp://host:8786`; or `local:N` for N workers here.

    Raises:
        DataError: Dask is missing, the address cannot be used, or nobody answers.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client, LocalCluster
        except ImportError as error:
            raise DataError("--scheduler needs Dask: pip install 'mbd_ros[dask]'") from error
        self._local: Any = None
        if address.startswith("local:"):
            number = address.removeprefix("local:")
            if not (number.isdecimal() and int(number)):
                raise DataError(f"--scheduler {address}: expected local:N with N > 0")
            self._local = LocalCluster(
                n_workers=int(number), threads_per_worker=1, dashboard_address=":0"
            )
        try:
            self._client: Any = Client(self._local or address, timeout=_CONNECT)
        except (OSError, ValueError) as error:
            raise DataError(f"--scheduler {address}: {error}") from error

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()
        if self._local is not None:
            self._local.close()

    @property
    def count(self) -> int:
        """How many tasks are done at the same time; 0 while there are no workers."""
        return sum(self._client.nthreads().values())

    def run(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Result]]:
        """Every task with its result, in the order in which they end; one at a time if alone."""
        from distributed import TimeoutError as Waited  # of asyncio on Python 3.10
        from distributed import wait

        waiting, flying = deque(tasks), {}
        seen = time.monotonic()
        host = self._host() if alone and tasks else None
        while waiting or flying:
            while waiting and len(flying) < (1 if alone else _AHEAD * max(self.count, 1)):
                task = waiting.popleft()
                flying[self._client.submit(do_within, task, pure=False, workers=host)] = task
            try:
                done = wait(list(flying), _LOOK, return_when="FIRST_COMPLETED").done
            except Waited:
                seen = self._look(seen)
                if host is not None and host not in self._hosts():
                    host = self._host()
                    waiting.extend(flying.values())
                    self._client.cancel(list(flying), force=True)
                    flying.clear()
                continue
            seen = time.monotonic()
            for future in done:
                yield flying.pop(future), _result(future)

    def cpu(self) -> str:
        """Processor of the host on which tasks that want to be alone are done.

        Raises:
            DataError: There are no workers.
        """
        ((_, result),) = self.run([Task("processor", f"{do.__module__}:nothing", {})], alone=True)
        return result.cpu

    def _hosts(self) -> Counter[str]:
        """Workers a host."""
        workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        return Counter(worker["host"] for worker in workers)

    def _host(self) -> str | None:
        """The one with most workers."""
        hosts = self._hosts()
        return min(hosts, key=lambda host: (-hosts[host], host)) if hosts else None

    def _look(self, seen: float) -> float:
        """When there was a worker or an answer last."""
        if self._hosts():
            return time.monotonic()
        if time.monotonic() - seen > _DESERTED:
            raise DataError(f"the Dask scheduler had no workers for {_DESERTED:g} s")
        return seen


def do_within(task: Task) -> Result:
    """Do a task in a worker of Dask, and give it up where that takes longer than its limit.

    Nothing ends a thread from outside: one that was given up runs until its worker ends.
    """
    if math.isinf(task.limit):
        return do(task)
    results: list[Result] = []
    thread = threading.Thread(target=lambda: results.append(do(task)), daemon=True)
    thread.start()
    thread.join(task.limit)
    return results[0] if results else Result(failure=f"no result within {task.limit:g} s")


def _result(future: Any) -> Result:
    if future.status == "cancelled":
        raise DataError("the Dask scheduler is lost; what was done is kept")
    error = future.exception()  # waits where a result was lost with its worker and is made again
    if error is not None:
        return Result(failure=f"Dask gave it up: {error}")
    result: Result = future.result()
    return result
