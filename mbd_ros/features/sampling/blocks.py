"""Blocks of chains, done here or by workers: the same bits wherever."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, DivergedError, SceneError
from mbd_ros.features.sampling.chain_setup import Asked, Order
from mbd_ros.features.sampling.chains import Checkpoint, Sampled
from mbd_ros.features.sampling.task import SampleTask, sample_task
from mbd_ros.jobs.workers.opening import do_all, open_workers
from mbd_ros.jobs.workers.remaining import watched
from mbd_ros.jobs.workers.task import Task
from mbd_ros.scene.reader import load_any

# Arrays as JSON holds them, to the bit: what goes to workers and comes back.


def listed(done: Sampled) -> dict[str, Any]:
    """What a block of chains gave."""
    return {
        "values": _packed(done.values),
        "accepted": _packed(done.accepted),
        "end": listed_checkpoint(done.end),
    }


def received(value: Mapping[str, Any]) -> Sampled:
    """The same back."""
    values, accepted = (_unpacked(value[key]) for key in ("values", "accepted"))
    return Sampled(values, accepted, checkpoint(value["end"]))


def listed_checkpoint(one: Checkpoint) -> list[Any]:
    """Where a block of chains stands."""
    return [_packed(one.q), _packed(one.v), one.sweeps, one.dt]


def checkpoint(listed: Sequence[Any]) -> Checkpoint:
    """The same back."""
    q, v, sweeps, dt = listed
    return Checkpoint(_unpacked(q), _unpacked(v), sweeps, dt)


def _packed(values: Array) -> list[Any]:
    data = np.ascontiguousarray(values, dtype="<f8").tobytes()
    return [list(values.shape), base64.b64encode(data).decode()]


def _unpacked(packed: Sequence[Any]) -> Array:
    shape, data = packed
    return np.frombuffer(base64.b64decode(data), dtype="<f8").reshape(shape).copy()


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
