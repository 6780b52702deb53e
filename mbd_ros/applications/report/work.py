"""Items of the parts as tasks for workers, and their results."""

import importlib
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.applications.report import items
from mbd_ros.applications.report.items import Item, Outcome, Section
from mbd_ros.applications.report.program import program
from mbd_ros.applications.report.store import Store
from mbd_ros.errors import DataError
from mbd_ros.jobs.workers.opening import Workers, do_all
from mbd_ros.jobs.workers.remaining import watched
from mbd_ros.jobs.workers.task import Result, Task
from mbd_ros.scene.schema.code_permission import is_permitted, permitting

_PATIENCE, _SLOWER = 300.0, 20.0  # s; how many times slower than expected is still waited for


def collect(
    kinds: Sequence[str], scenes: Sequence[str], quick: bool
) -> dict[str, list[Item] | Section]:
    """The items of every kind; a section that says so where a package is missing."""
    found: dict[str, list[Item] | Section] = {}
    for kind in kinds:
        try:
            found[kind] = _checked(kind, items.part(kind).items(scenes, quick))
        except ModuleNotFoundError as error:
            if str(error.name).startswith("mbd_ros"):
                raise
            line = f"{error.name} is not installed: pip install 'mbd_ros[{kind}]' brings it."
            found[kind] = Section(kind.replace("_", " ").capitalize(), [line])
    return found


def _checked(kind: str, work: list[Item]) -> list[Item]:
    twice = [name for name, count in Counter(item.name for item in work).items() if count > 1]
    strange = {item.kind for item in work} - {kind}
    if twice or strange:
        raise ValueError(f"items of {kind}: names {twice} twice, kinds {strange}")
    return work


def finish(
    work: Sequence[Item], store: Store, workers: Workers, *, elsewhere: bool
) -> dict[str, Result]:
    """Do items and store every result at once.

    Args:
        work: The items.
        store: Where results are kept.
        workers: Those who do them.
        elsewhere: They may have another version of this package, and are asked.

    Returns:
        Label of an item -> its result.
    """
    tasks = [_task(item, elsewhere) for item in work]
    items_of = {label(item): item for item in work}
    results = {}
    for task, result in watched(do_all(workers, tasks), tasks, workers.count):
        store.save(items_of[task.name], result)
        results[task.name] = result
    return results


def label(item: Item) -> str:
    """What an item is called among those of all kinds."""
    return f"{item.kind}/{item.name}"


def _task(item: Item, elsewhere: bool) -> Task:
    module = items.PARTS[item.kind]
    wanted = program(module) if elsewhere else None
    argument = {"module": module, "program": wanted, "spec": item.spec}
    argument["allow_code"] = is_permitted()
    limit = max(_PATIENCE, _SLOWER * item.seconds)
    call = f"{__name__}:{perform.__name__}"
    return Task(label(item), call, argument, item.seconds, item.alone, limit)


def perform(argument: Mapping[str, Any]) -> Outcome:
    """Run one item in a worker.

    Raises:
        DataError: The worker has another version of the program.
    """
    module, wanted = argument["module"], argument["program"]
    if wanted is not None and program(module) != wanted:
        raise DataError("this worker has other sources or package versions")
    quiet = np.errstate(over="ignore", invalid="ignore")  # a divergence says so itself
    with quiet, permitting(argument["allow_code"]):
        outcome: Outcome = importlib.import_module(module).run(argument["spec"])
    return outcome
