"""Blocks of chains, done here or by workers: the same bits wherever."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.errors import DataError, DivergedError, SceneError
from mbd_ros.features.sampling.chain_setup import Asked, Order
from mbd_ros.features.sampling.chains import Sampled
from mbd_ros.features.sampling.packing import checkpoint, listed, listed_checkpoint, received
from mbd_ros.features.sampling.task import SampleTask, sample_task
from mbd_ros.jobs.workers.opening import do_all, open_workers
from mbd_ros.jobs.workers.remaining import watched
from mbd_ros.jobs.workers.task import Task
from mbd_ros.scene.reader import load_any


def blocks_done(
    asked: Asked, orders: Sequence[Order], workers: int | None, scheduler: str | None
) -> list[Sampled]:
    """Blocks of chains, in the order of `orders`, here or by workers.

    Raises:
        DataError: A worker has failed.
        MbdError: As `Asked.done`.
    """
    scene = asked.scene
    alone = scene.path is None or getattr(scene, "code", False) or len(orders) < 2
    if alone or (workers == 1 and scheduler is None):
        return [asked.done(order) for order in orders]
    entries = _entries(asked.task)
    tasks = [
        Task(str(i), f"{__name__}:do", {"scene": str(scene.path), "task": entries} | _sent(order))
        for i, order in enumerate(orders)
    ]
    with open_workers(scheduler, workers) as opened:
        done = {t.name: r for t, r in watched(do_all(opened, tasks), tasks, opened.count)}
    for task in tasks:
        failure = done[task.name].failure
        if failure:
            raise _failed(failure)
    return [received(done[task.name].value) for task in tasks]


def do(sent: Mapping[str, Any]) -> dict[str, Any]:
    """A block of chains in a worker."""
    asked = Asked(load_any(sent["scene"]), sample_task(sent["task"], "sample"), "sample")
    start = None if sent["start"] is None else checkpoint(sent["start"])
    return listed(asked.done(Order(sent["number"], sent["level"], start)))


def _failed(failure: str) -> Exception:
    kind, _, text = failure.partition(": ")
    kinds = {"DivergedError": DivergedError, "SceneError": SceneError}
    return kinds[kind](text.rpartition(" (")[0]) if kind in kinds else DataError(failure)


def _entries(task: SampleTask) -> dict[str, Any]:
    entries = {key: value for key, value in vars(task).items() if value is not None}
    entries["observe"], entries["histograms"] = dict(task.observe), {}
    entries["at"] = list(task.at)
    if task.coordinate is None:
        del entries["at"]
    return entries


def _sent(order: Order) -> dict[str, Any]:
    start = None if order.start is None else listed_checkpoint(order.start)
    return {"number": order.number, "level": order.level, "start": start}
