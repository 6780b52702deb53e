"""Tasks in processes of this machine; a process that dies never affects other tasks."""

from __future__ import annotations

import math
import multiprocessing as mp
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import NamedTuple

from mbd_ros.jobs.workers.task import Result, Task, cpu, do

_ATTEMPTS = 2
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_CONTEXT = mp.get_context("spawn")  # a fork would inherit threads and their locks


class Processes:
    """Workers that are processes of this machine, for the length of a `with` block.

    A task whose process dies is tried once more. The processes always end with this one.

    Args:
        count: Number of processes.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._workers: list[_Worker] = []

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.kill()
        while self._workers:
            worker = self._workers.pop()
            worker.process.join()
            worker.connection.close()

    def cpu(self) -> str:
        """Return the name of the processor of this machine."""
        return cpu()

    def run(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Result]]:
        """Yield every task with its result as they end; run one at a time if `alone`."""
        waiting = deque((task, 1) for task in tasks)
        while waiting or self._busy():
            while waiting and len(self._busy()) < (1 if alone else self.count):
                task, attempt = waiting.popleft()
                self._idle().start(_Job(task, attempt, time.monotonic() + task.limit))
            for worker in self._settled():
                job = worker.job
                assert job is not None
                result = self._answer(worker, job)
                if result is not None:
                    yield job.task, result
                else:
                    waiting.appendleft((job.task, job.attempt + 1))

    def _busy(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker.job is not None]

    def _idle(self) -> _Worker:
        for worker in self._workers:
            if worker.job is None:
                return worker
        self._workers.append(_Worker())
        return self._workers[-1]

    def _settled(self) -> list[_Worker]:
        """Wait for workers that have answered, have died or are overdue, and return them."""
        busy = self._busy()
        due = min(worker.job.due for worker in busy if worker.job is not None)
        timeout = None if math.isinf(due) else max(due - time.monotonic(), 0.0)
        ready = wait([worker.connection for worker in busy], timeout)
        now = time.monotonic()
        return [w for w in busy if w.connection in ready or (w.job and w.job.due <= now)]

    def _answer(self, worker: _Worker, job: _Job) -> Result | None:
        """Return the result of a settled worker; None if the task shall be tried again."""
        try:
            if worker.connection.poll():
                result: Result = worker.connection.recv()
                worker.job = None
                return result
        except (EOFError, OSError):
            self._workers.remove(worker)
            how = worker.end()
            if job.attempt < _ATTEMPTS:
                return None
            return Result(failure=f"its process ended {how} in each of {_ATTEMPTS} attempts")
        self._workers.remove(worker)
        worker.job = None
        worker.end()
        return Result(failure=f"no result within {job.task.limit:g} s")


class _Worker:
    """A process that runs one task after the other."""

    def __init__(self) -> None:
        self.connection, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.job: _Job | None = None

    def start(self, job: _Job) -> None:
        self.job = job
        with suppress(OSError):  # a worker that has died is noticed when its answer is awaited
            self.connection.send(job.task)

    def end(self) -> str:
        """Kill the process, and return how it ended before."""
        self.process.join(0.0 if self.job is None else 1.0)
        code = self.process.exitcode
        self.process.kill()
        self.process.join()
        self.connection.close()
        if code is not None and code < 0:
            return f"by {signal.Signals(-code).name}"
        return f"with exit code {code}"


def _serve(connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent process
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            connection.send(do(connection.recv()))


def _end_with_parent() -> None:
    parent = mp.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


class _Job(NamedTuple):
    task: Task
    attempt: int
    due: float  # time.monotonic
