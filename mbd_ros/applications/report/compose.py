"""From parts to a page: `mbd-ros report`."""

from __future__ import annotations

import importlib
import json
import math
import os
import platform
import subprocess
import time
from collections import Counter
from collections.abc import Generator, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mbd_ros
from mbd_ros.applications.report import items
from mbd_ros.applications.report.items import Item, Outcome, Section
from mbd_ros.applications.report.page import page
from mbd_ros.applications.report.store import VERSIONS, Store, program, versions
from mbd_ros.applications.report.subjects import Subject, subjects
from mbd_ros.compiled.build.compiler import cores
from mbd_ros.errors import FAILED, DataError, MbdError
from mbd_ros.features.simulation.job import Interrupted, simulate
from mbd_ros.files.output_folder import make_folder, place_in
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.workers.opening import (
    Remaining,
    Workers,
    do_all,
    duration_text,
    open_workers,
    watched,
)
from mbd_ros.jobs.workers.task import Result, Task, cpu
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import is_permitted, permitting
from mbd_ros.scene.schema.locate import find_scene
from mbd_ros.view.frames import Frames
from mbd_ros.view.motion import viewed_motion
from mbd_ros.view.recording import animated_page

_PATIENCE, _SLOWER = 300.0, 20.0  # s; how many times slower than expected is still waited for
FOLDER = "scenes"  # pages beside a report that show its scenes as they move
_LONGEST = 2.0  # s that a page shows
_SHOWN = ("mbd_ros", *VERSIONS, "matplotlib", "dask")  # packages whose version is told
_GIB = 2**30
_DPI = 150


def report(order: Order) -> Iterator[str]:
    """Run items without a result, then write page, numbers and plots.

    Yields:
        What happens, a line each.

    Raises:
        Wrong: A part or an item has something wrong.
        DataError: Input that cannot be used.
    """
    program.cache_clear()  # of a process that made a report before
    begin, facts = time.monotonic(), _facts(order)
    scenes = list(dict.fromkeys(map(_scene, order.scenes)))
    kinds = [kind for kind in items.PARTS if not order.only or kind in order.only]
    work_of = collect(kinds, scenes, order.quick)
    work = [item for made in work_of.values() if isinstance(made, list) for item in made]
    results: dict[str, Result] = {}
    facts["changed"] = yield from _results(order, work, results)
    sections = {kind: _section(kind, made, results) for kind, made in work_of.items()}
    sections = {k: _requested(s) if k in order.only else s for k, s in sections.items()}
    facts["pages"] = {}
    if not (order.quick or order.only):
        measured = {item.spec.get("scene") for item in work}
        shown = [subject for subject in subjects(scenes, False) if subject.path in measured]
        yield from scene_pages(shown, order.out, facts["pages"])
    facts["duration"] = time.monotonic() - begin
    wrong = _write(order.out, facts, sections, [(item, results[label(item)]) for item in work])
    yield f"{len(sections)} sections -> {order.out / 'index.html'}"
    if wrong:
        raise Wrong("\n".join([f"{len(wrong)} wrong:", *wrong]))


class Order(NamedTuple):
    """The order of a user.

    Attributes:
        scenes: Files, package:// names, or names of embedded scenes; none for all of ours.
        quick: The short version.
        out: Folder for page, numbers, plots and results.
        scheduler: Of a Dask cluster; None for processes of this machine.
        workers: How many processes; None for one a core.
        only: Kinds; none for all.
    """

    scenes: Sequence[str] = ()
    quick: bool = False
    out: Path = Path("report_out")
    scheduler: str | None = None
    workers: int | None = None
    only: Sequence[str] = ()


def _facts(order: Order) -> dict[str, Any]:
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "quick": order.quick,
        "scenes": list(order.scenes),
        "machine": machine(),
        "versions": package_versions(),
        "git": git_state(),
    }


def machine() -> dict[str, Any]:
    """Processor, memory, system and load."""
    described = {"cpu": cpu(), "cores": cores(), "system": platform.platform()}
    if hasattr(os, "sysconf"):
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        described["memory"] = f"{size / _GIB:.1f} GiB"
    if hasattr(os, "getloadavg"):
        described["load"] = f"{os.getloadavg()[0]:.2f} at the start"
    return described


def package_versions() -> dict[str, str]:
    """Versions of this package and of its libraries."""
    return versions(_SHOWN)


def git_state() -> dict[str, Any]:
    """Commit of the checkout, and whether it was changed; empty outside of one."""
    package = Path(mbd_ros.__path__[0])
    try:
        if not _git(package, "ls-files", "cli.py"):
            return {}
        changed = bool(_git(package, "status", "--porcelain", "--untracked-files=all", "."))
        return {"commit": _git(package, "rev-parse", "HEAD"), "changed": changed}
    except (OSError, subprocess.SubprocessError):
        return {}


def _git(folder: Path, *words: str) -> str:
    command = ["git", "-C", str(folder), *words]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    return ran.stdout.strip()


def _scene(name: str) -> str:
    """A name that means the same in every worker, of a scene that can be built.

    Raises:
        MbdError: There is no such scene, or what is wrong with it.
    """
    if not name.startswith("package://"):
        path = find_scene(name)
        if not path.is_file():
            raise DataError(f"{name}: does not exist")
        name = str(path.resolve())
    load_scene(name)
    return name


def _results(
    order: Order, work: Sequence[Item], results: dict[str, Result]
) -> Generator[str, None, list[str]]:
    """Fill in stored and new results; returns files that changed meanwhile."""
    with open_workers(order.scheduler, order.workers) as workers:
        store = Store(order.out, workers.cpu())
        results |= {label(item): r for item in work if (r := store.load(item)) is not None}
        rest = [item for item in work if label(item) not in results]
        yield f"{len(work)} items, {len(results)} of them done before"
        if rest:
            expected = Remaining(rest, workers.count).seconds
            yield f"{len(rest)} items by {workers.count} workers: about {duration_text(expected)}"
            results |= finish(rest, store, workers, elsewhere=_elsewhere(order))
    if store.changed:
        yield f"changed while this ran: {', '.join(store.changed)}; run it again"
    return list(store.changed)


def label(item: Item) -> str:
    """Return the label of an item, unique among all kinds."""
    return f"{item.kind}/{item.name}"


def _elsewhere(order: Order) -> bool:
    return order.scheduler is not None and not order.scheduler.startswith("local:")


def _section(kind: str, made: list[Item] | Section, results: Mapping[str, Result]) -> Section:
    if isinstance(made, Section):
        return made
    mine = [(item, results[label(item)]) for item in made]
    failures = [f"{label(item)}: {r.failure}" for item, r in mine if r.failure]
    section = items.part(kind).section([(item, r.value) for item, r in mine if not r.failure])
    return section._replace(wrong=[*failures, *section.wrong])


def _requested(section: Section) -> Section:
    """Refuse a kind that was asked for by name and has nothing to show, with the reason."""
    if section.tables or section.wrong:
        return section
    reasons = " ".join(section.text)
    return section._replace(wrong=[f"asked for, but nothing was measured: {reasons}"])


def _write(
    folder: Path,
    facts: dict[str, Any],
    sections: Mapping[str, Section],
    work: Sequence[tuple[Item, Result]],
) -> list[str]:
    """Plots first, page last; returns what is wrong."""
    pictures = {}
    for section in sections.values():
        for name, figure in section.figures.items():
            pictures[name] = _picture(figure)
            with replacing(place_in(folder, f"{name}.png")) as file:
                file.write(pictures[name])
    wrong = [f"{s.title}: {line}" for s in sections.values() for line in s.wrong]
    facts["wrong"] = wrong
    facts["timed"] = sum(item.alone for item, _ in work)
    facts["cpus"] = sorted({r.cpu for item, r in work if item.alone})
    facts["work"] = sum(result.seconds for _, result in work)
    shown = {kind: s._replace(figures=list(s.figures))._asdict() for kind, s in sections.items()}
    done = [_entry(item, result) for item, result in work]
    numbers = json.dumps(plain({**facts, "sections": shown, "items": done}), indent=1)
    with replacing(folder / "report.json") as file:
        file.write(numbers.encode())
    with replacing(folder / "index.html") as file:
        file.write(page(facts, sections, pictures).encode())
    return wrong


def _picture(figure: Any) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()


def _entry(item: Item, result: Result) -> dict[str, Any]:
    what = {"failure": result.failure} if result.failure else {"outcome": result.value}
    return {**item._asdict(), **what, "took": result.seconds, "cpu": result.cpu}


def plain(value: Any) -> Any:
    """The same for readers whose JSON has no NaN and no infinity: these become texts."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value


class Wrong(MbdError):
    """A report with something wrong; its page is complete."""

    exit_code = FAILED


def collect(
    kinds: Sequence[str], scenes: Sequence[str], quick: bool
) -> dict[str, list[Item] | Section]:
    """The items of every kind; a section that says so where a package is missing."""
    collected: dict[str, list[Item] | Section] = {}
    for kind in kinds:
        try:
            collected[kind] = _checked(kind, items.part(kind).items(scenes, quick))
        except ModuleNotFoundError as error:
            if str(error.name).startswith("mbd_ros"):
                raise
            line = f"{error.name} is not installed: pip install 'mbd_ros[{kind}]' brings it."
            collected[kind] = Section(kind.replace("_", " ").capitalize(), [line])
    return collected


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


def scene_pages(subjects: Sequence[Subject], folder: Path, made: dict[str, str]) -> Iterator[str]:
    """Write a page for each scene that runs.

    Args:
        folder: Of the report.
        made: Is filled in: name of a scene -> its page, relative to the folder.

    Yields:
        What is left out, a line each.
    """
    if not subjects:
        return
    if find_spec("viser") is None:
        yield "no pages of scenes: pip install 'mbd_ros[view]'"
        return
    pages = place_in(folder, FOLDER)
    make_folder(pages)
    for subject in subjects:
        try:
            text = _page(subject)
        except Interrupted:
            raise
        except MbdError as error:
            yield f"no page of {subject.name}: {error}"
            continue
        made[subject.name] = f"{FOLDER}/{subject.name}.html"
        with replacing(place_in(pages, f"{subject.name}.html")) as file:
            file.write(text.encode())


def _page(subject: Subject) -> str:
    scene = load_scene(subject.path)
    if not scene.robot.model.nv:
        raise DataError("nothing moves")
    result = simulate(scene, min(subject.times[-1], _LONGEST))
    motion = viewed_motion(scene, result, Frames(scene).rows)
    return animated_page(scene, motion, subject.name).text
