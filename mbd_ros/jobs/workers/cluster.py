"""Tasks on a Dask cluster; results do not depend on how many workers it has or loses."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import Any

from mbd_ros.errors import DataError
from mbd_ros.jobs.workers.task import Result, Task, do

_CONNECT_TIMEOUT = 10.0  # s
_POLL_PERIOD = 5.0  # s
_LONGEST_ABSENCE = 60.0  # s without workers
_AHEAD = 3  # tasks per worker, so that no worker waits for its next task


class Cluster:
    """Workers of a Dask cluster, for the length of a `with` block.

    A task whose worker is lost goes to another one; Dask abandons a task after it has lost four
    workers. Tasks that must run alone run one at a time, all on the same host.

    Args:
        address: Address of the scheduler, such as `tcp://host:8786`; or `local:N` for N workers
            on this machine.

    Raises:
        DataError: Dask is missing, the address cannot be used, or no scheduler answers.
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
            self._client: Any = Client(self._local or address, timeout=_CONNECT_TIMEOUT)
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
        """Number of tasks that run at the same time; 0 while there are no workers."""
        return sum(self._client.nthreads().values())

    def run(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Result]]:
        """Yield every task with its result as they end; run one at a time if `alone`."""
        from distributed import TimeoutError as Waited  # of asyncio on Python 3.10
        from distributed import wait

        waiting, running = deque(tasks), {}
        seen = time.monotonic()
        host = self._host() if alone and tasks else None
        while waiting or running:
            while waiting and len(running) < (1 if alone else _AHEAD * max(self.count, 1)):
                task = waiting.popleft()
                running[self._client.submit(do_within, task, pure=False, workers=host)] = task
            try:
                done = wait(list(running), _POLL_PERIOD, return_when="FIRST_COMPLETED").done
            except Waited:
                seen = self._last_contact(seen)
                if host is not None and host not in self._hosts():
                    host = self._host()
                    waiting.extend(running.values())
                    self._client.cancel(list(running), force=True)
                    running.clear()
                continue
            seen = time.monotonic()
            for future in done:
                yield running.pop(future), _result(future)

    def cpu(self) -> str:
        """Return the processor of the host that runs the tasks which must run alone.

        Raises:
            DataError: There are no workers.
        """
        ((_, result),) = self.run([Task("processor", f"{do.__module__}:nothing", {})], alone=True)
        return result.cpu

    def _hosts(self) -> Counter[str]:
        """Return the number of workers by host."""
        workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        return Counter(worker["host"] for worker in workers)

    def _host(self) -> str | None:
        """Return the host with most workers; None without workers."""
        hosts = self._hosts()
        return min(hosts, key=lambda host: (-hosts[host], host)) if hosts else None

    def _last_contact(self, seen: float) -> float:
        """Return the last time at which there was a worker or an answer."""
        if self._hosts():
            return time.monotonic()
        if time.monotonic() - seen > _LONGEST_ABSENCE:
            raise DataError(f"the Dask scheduler had no workers for {_LONGEST_ABSENCE:g} s")
        return seen


def do_within(task: Task) -> Result:
    """Run a task in a worker of Dask, and abandon it after its time limit.

    A thread cannot be ended from outside: an abandoned one runs until its worker ends.
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
        raise DataError("the connection to the Dask scheduler is lost; finished results are kept")
    error = (
        future.exception()
    )  # waits if the result was lost with its worker and is computed again
    if error is not None:
        return Result(failure=f"Dask abandoned it: {error}")
    result: Result = future.result()
    return result
