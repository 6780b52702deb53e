"""Periodic motions of a scene: `mbd-ros gait`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import DataError, ModelError, SceneError
from mbd_ros.features.gait.continuation import NamedBranch, branch_lines, branches_of, own_value
from mbd_ros.features.gait.search import Gait, SceneFamily, found_gaits
from mbd_ros.features.gait.tables import (
    BASIN,
    BRANCHES,
    GAITS,
    Measures,
    basin_table,
    branch_table,
    gait_table,
    measures_of,
    motion_table,
)
from mbd_ros.features.gait.task import GaitTask, gait_task
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, watching
from mbd_ros.jobs.result_files import beside, write_tables
from mbd_ros.motion.columns import state_topics
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.task_reader import read_task

_SHOWN = 6  # multipliers in a line
_SMALL = 1.0e-9  # multiplier that is not shown: what differences leave of none

_PAGES = (".html", ".htm")


def gait(
    scene: Scene,
    task: str | Path | Mapping[str, Any] | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    say: Say | None = None,
    progress: Watch = False,
) -> Result:
    """Periodic motions, their stability, branches along a parameter, and basins.

    Args:
        scene: A scene with phases, or other events.
        task: A task file with a section `gait`, or its keys; None for a gait near the start of
            the scene.
        workers: How many cores scan a basin; None for all.
        scheduler: Of a Dask cluster, in place of them.
        say: Is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.

    Returns:
        Table `samples`: the first gait over the cycles after which it repeats, as of a simulation.
        Table `gaits`, a row a gait; `branches`, a row a point, where the task asks for a
        continuation; `basin`, a row a start, where it asks for that. See `features.gait.tables`.

    Raises:
        FallError: No guess comes to the end of a cycle.
        SolveError: No guess leads to a periodic motion.
        SceneError: The task cannot be read, or does not fit the scene.
    """
    remarks: list[str] = []
    with watching(progress):
        asked = task_of(scene, task)
        result = run_gait(scene, asked, say or remarks.append, workers, scheduler)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def task_of(scene: Scene, task: str | Path | Mapping[str, Any] | None) -> GaitTask:
    """The task of a file, or of the keys of its section."""
    if isinstance(task, str | Path):
        parts = read_task(task, scene).parts
        found: GaitTask = parts["gait"] if "gait" in parts else gait_task({}, str(task))
        return found
    return gait_task(dict(task or {}), "gait")


def run_gait(
    scene: Scene, task: GaitTask, say: Say, workers: int | None, scheduler: str | None
) -> Result:
    """Do the task of `gait`."""
    along = task.continuation
    family = SceneFamily(scene, task, "" if along is None else along.parameter)
    if along is not None:
        own_value(family, along)
    for frame in task.step_between:
        try:
            scene.robot.frame(frame)
        except ModelError as error:
            where = task.source or scene.name
            raise SceneError(f"{where}: gait.step_between: {error}") from error
    flow, gaits = family.flow(), found_gaits(family, say)
    with about(task.source or scene.name):
        found = [measures_of(scene, task, flow, one.travel, one.motion) for one in gaits]
    for line in gait_lines(gaits, found):
        say(line)
    tables = {MAIN: motion_table(flow, gaits[0]), GAITS: gait_table(flow, gaits, found)}
    if along is not None:
        tables[BRANCHES] = _branches(family, gaits, say)
    if task.basin is not None:
        tables[BASIN] = _basin(family, gaits, say, workers, scheduler)
    topics = state_topics(scene.robot, ("position", "velocity", "effort"))
    inputs = {"task": task.source or None}
    return Result(tables, metadata_of("gait", scene, inputs, topics))


def gait_lines(gaits: Sequence[Gait], found: Sequence[Measures]) -> Iterator[str]:
    """What is said of gaits."""
    for number, (one, measures) in enumerate(zip(gaits, found, strict=True), 1):
        motion = one.motion
        word = "stable" if motion.is_stable else "unstable"
        events = ", ".join(name for s in motion.passage.segments for name in s.event)
        yield f"gait {number}: {word}, period {measures.period:.12g} s, {events}"
        if measures.travel is not None and measures.speed is not None:
            yield f"  travel {measures.travel:.12g} m, speed {measures.speed:.12g} m/s"
        yield f"  multipliers {multiplier_words(motion.multipliers)}"
        text = f"  energy lost at events {measures.energy_lost:.9g} J"
        if measures.positive_work or measures.negative_work:
            text += (
                f", work of actuators {measures.positive_work:+.9g} "
                f"{measures.negative_work:+.9g} J"
            )
        if measures.cost_of_transport:
            text += f", cost of transport {measures.cost_of_transport:.9g}"
        yield text
        if one.travel.names:
            yield f"  travels along {', '.join(one.travel.names)}; residual {motion.residual:.2g}"


def multiplier_words(multipliers: Any) -> str:
    """Floquet multipliers for people; those that are none are left out."""
    shown = [m for m in multipliers if abs(m) > _SMALL][:_SHOWN] or [0.0]
    words = []
    for m in np.asarray(shown, dtype=complex):
        turned = f" {'-' if m.imag < 0.0 else '+'} {abs(m.imag):.9f}i" if m.imag else ""
        words.append(f"{m.real:.9f}{turned}")
    return ", ".join(words)


def _branches(family: SceneFamily, gaits: Sequence[Gait], say: Say) -> Table:
    along = family.task.continuation
    assert along is not None
    found: list[NamedBranch] = []
    for number, one in enumerate(gaits, 1):
        for branch in branches_of(family, one, number, along, say):
            found.append(branch)
            for line in branch_lines(branch, along.parameter):
                say(line)
    return branch_table(family.flow(), found, gaits)


def _basin(
    family: SceneFamily,
    gaits: Sequence[Gait],
    say: Say,
    workers: int | None,
    scheduler: str | None,
) -> Table:
    from mbd_ros.features.gait.basin import basin_of, outcome_word

    assert family.task.basin is not None
    outcomes = basin_of(family, gaits, family.task.basin, workers, scheduler)
    words = [outcome_word(one.number) for one in outcomes]
    counts = ", ".join(f"{word} {words.count(word)}" for word in sorted(set(words)))
    say(f"basin: {len(words)} starts: {counts}")
    return basin_table(outcomes)


def gait_to(
    scene: Scene,
    task: Path | None,
    out: Path | None,
    page: Path | None,
    say: Say,
    workers: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Find gaits, and write them where a place is given.

    Args:
        task: Task file; None for a gait near the start of the scene.
        out: The motion of the first gait; its suffix chooses the format.
        page: A page for people.
        say: Is told what was found, a line each.
        workers: How many cores scan a basin; None for all.
        scheduler: Of a Dask cluster, in place of them.
    """
    asked = task_of(scene, task)
    if page is not None and page.suffix not in _PAGES:
        raise DataError(f"--page {page}: expected the suffix .html")
    for place in filter(None, (out, page)):
        refuse_overwriting(place, task, scene.path)
    if out is not None:
        for place in (out, *(beside(out, name) for name in (GAITS, BRANCHES, BASIN))):
            check_place(place)
    if page is not None and not page.parent.is_dir():
        raise DataError(f"{page}: directory {page.parent} does not exist")
    result = run_gait(scene, asked, say, workers, scheduler)
    if out is not None:
        write_tables(result, out, say)
    if page is not None:
        from mbd_ros.features.gait.page import write_page

        write_page(
            result, page, "" if asked.continuation is None else asked.continuation.parameter
        )
        say(f"page -> {page}")
