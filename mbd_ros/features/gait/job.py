"""Search for the periodic motions of a scene: `mbd-ros gait`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import DataError, ModelError, SceneError
from mbd_ros.features.gait.continuation import (
    NamedBranch,
    branch_lines,
    follow_branches,
    scene_value,
)
from mbd_ros.features.gait.search import Gait, SceneFamily, search_gaits
from mbd_ros.features.gait.tables import (
    BASIN,
    BRANCHES,
    GAITS,
    Measures,
    basin_table,
    branch_table,
    gait_table,
    measure_gait,
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
_SMALL = 1.0e-9  # smaller multipliers are rounding of difference quotients

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
    """Search periodic motions, their stability, branches along a parameter, and basins.

    Args:
        scene: A scene with phases, or other events.
        task: A task file with a section `gait`, or its keys; None for a gait near the start of
            the scene.
        workers: Number of processes for a basin; None for all cores.
        scheduler: Address of a Dask cluster that replaces them.
        say: Function that is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for a progress line on a terminal, or a function of a label and a share.

    Returns:
        Table `samples`: the first gait until it repeats, with the columns of a simulation. Table
        `gaits`: one gait per row. Table `branches`: one point per row, if the task asks for a
        continuation. Table `basin`: one start per row, if the task asks for it. See
        `features.gait.tables`.

    Raises:
        FallError: No guess reaches the end of a cycle.
        SolveError: No guess leads to a periodic motion.
        SceneError: The task cannot be read, or does not fit the scene.
    """
    remarks: list[str] = []
    with watching(progress):
        options = read_gait_task(scene, task)
        result = run_gait(scene, options, say or remarks.append, workers, scheduler)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def read_gait_task(scene: Scene, task: str | Path | Mapping[str, Any] | None) -> GaitTask:
    """Return the task of a file, or of the keys of its section."""
    if isinstance(task, str | Path):
        parts = read_task(task, scene).parts
        section: GaitTask = parts["gait"] if "gait" in parts else gait_task({}, str(task))
        return section
    return gait_task(dict(task or {}), "gait")


def run_gait(
    scene: Scene, task: GaitTask, say: Say, workers: int | None, scheduler: str | None
) -> Result:
    """Search gaits as a task says."""
    continuation = task.continuation
    family = SceneFamily(scene, task, "" if continuation is None else continuation.parameter)
    if continuation is not None:
        scene_value(family, continuation)
    for frame in task.step_between:
        try:
            scene.robot.frame(frame)
        except ModelError as error:
            where = task.source or scene.name
            raise SceneError(f"{where}: gait.step_between: {error}") from error
    flow, gaits = family.flow(), search_gaits(family, say)
    with about(task.source or scene.name):
        measures = [measure_gait(scene, task, flow, g.travel, g.motion) for g in gaits]
    for line in gait_lines(gaits, measures):
        say(line)
    tables = {MAIN: motion_table(flow, gaits[0]), GAITS: gait_table(flow, gaits, measures)}
    if continuation is not None:
        tables[BRANCHES] = _branches(family, gaits, say)
    if task.basin is not None:
        tables[BASIN] = _basin(family, gaits, say, workers, scheduler)
    topics = state_topics(scene.robot, ("position", "velocity", "effort"))
    inputs = {"task": task.source or None}
    return Result(tables, metadata_of("gait", scene, inputs, topics))


def gait_lines(gaits: Sequence[Gait], all_measures: Sequence[Measures]) -> Iterator[str]:
    """Yield lines about gaits."""
    for number, (gait_, measures) in enumerate(zip(gaits, all_measures, strict=True), 1):
        motion = gait_.motion
        word = "stable" if motion.is_stable else "unstable"
        events = ", ".join(name for s in motion.passage.segments for name in s.event)
        yield f"gait {number}: {word}, period {measures.period:.12g} s, {events}"
        if measures.travel is not None and measures.speed is not None:
            yield f"  travel {measures.travel:.12g} m, speed {measures.speed:.12g} m/s"
        yield f"  multipliers {format_multipliers(motion.multipliers)}"
        text = f"  energy lost at events {measures.energy_lost:.9g} J"
        if measures.positive_work or measures.negative_work:
            text += (
                f", work of actuators {measures.positive_work:+.9g} "
                f"{measures.negative_work:+.9g} J"
            )
        if measures.cost_of_transport:
            text += f", cost of transport {measures.cost_of_transport:.9g}"
        yield text
        if gait_.travel.names:
            names = ", ".join(gait_.travel.names)
            yield f"  travels along {names}; residual {motion.residual:.2g}"


def format_multipliers(multipliers: Any) -> str:
    """Format Floquet multipliers for people, without those that are zero."""
    shown = [m for m in multipliers if abs(m) > _SMALL][:_SHOWN] or [0.0]
    texts = []
    for m in np.asarray(shown, dtype=complex):
        imaginary = f" {'-' if m.imag < 0.0 else '+'} {abs(m.imag):.9f}i" if m.imag else ""
        texts.append(f"{m.real:.9f}{imaginary}")
    return ", ".join(texts)


def _branches(family: SceneFamily, gaits: Sequence[Gait], say: Say) -> Table:
    continuation = family.task.continuation
    assert continuation is not None
    branches: list[NamedBranch] = []
    for number, gait_ in enumerate(gaits, 1):
        for branch in follow_branches(family, gait_, number, continuation, say):
            branches.append(branch)
            for line in branch_lines(branch, continuation.parameter):
                say(line)
    return branch_table(family.flow(), branches, gaits)


def _basin(
    family: SceneFamily,
    gaits: Sequence[Gait],
    say: Say,
    workers: int | None,
    scheduler: str | None,
) -> Table:
    from mbd_ros.features.gait.basin import outcome_text, scan_basin

    assert family.task.basin is not None
    outcomes = scan_basin(family, gaits, family.task.basin, workers, scheduler)
    texts = [outcome_text(outcome.number) for outcome in outcomes]
    counts = ", ".join(f"{text} {texts.count(text)}" for text in sorted(set(texts)))
    say(f"basin: {len(texts)} starts: {counts}")
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
    """Search gaits, and write the files that are given.

    Args:
        task: Task file; None for a gait near the start of the scene.
        out: File for the motion of the first gait; its suffix selects the format.
        page: HTML page with tables and pictures.
        say: Receives lines for people.
        workers: Number of processes for a basin; None for all cores.
        scheduler: Address of a Dask cluster that replaces them.
    """
    options = read_gait_task(scene, task)
    if page is not None and page.suffix not in _PAGES:
        raise DataError(f"--page {page}: the suffix must be .html or .htm")
    for place in filter(None, (out, page)):
        refuse_overwriting(place, task, scene.path)
    if out is not None:
        for place in (out, *(beside(out, name) for name in (GAITS, BRANCHES, BASIN))):
            check_place(place)
    if page is not None and not page.parent.is_dir():
        raise DataError(f"{page}: directory {page.parent} does not exist")
    result = run_gait(scene, options, say, workers, scheduler)
    if out is not None:
        write_tables(result, out, say)
    if page is not None:
        from mbd_ros.features.gait.page import write_page

        write_page(
            result, page, "" if options.continuation is None else options.continuation.parameter
        )
        say(f"page -> {page}")
