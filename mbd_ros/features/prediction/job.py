"""The best motion of a scene: `mbd-ros predict`."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mbd_ros.errors import NotConvergedError
from mbd_ros.features.prediction.failure import active, reasons
from mbd_ros.features.prediction.modes import modes_of
from mbd_ros.features.prediction.replay import NOT_AGAIN, Replay, replay, simulation_of
from mbd_ros.features.prediction.search import HERE, Where, search, where_of
from mbd_ros.features.prediction.solving import Found
from mbd_ros.features.prediction.tables import (
    CONTINUATION,
    GOALS,
    NODES,
    STARTS,
    asked_columns,
    continuation_table,
    goal_table,
    motion_table,
    node_table,
    residuals_of,
    start_table,
)
from mbd_ros.features.prediction.task import PredictTask, predict_task
from mbd_ros.files.output_file import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.jobs.progress import Say, Watch, say_all, watching
from mbd_ros.jobs.result_files import beside, write_tables
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.motion.state_table import topics_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.task_reader import read_task
from mbd_ros.scene.variants import with_numbers


def predict(
    scene: Scene,
    task: str | Path | Mapping[str, Any],
    *,
    say: Say | None = None,
    progress: Watch = False,
    workers: int | None = 1,
    scheduler: str | None = None,
) -> Result:
    """The motion that costs least, between what bounds and equations of motion let it be.

    Args:
        task: A task file with a section `predict`, or its keys; see docs/prediction.md.
        say: Is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for lines on a terminal.
        workers: How many processes try the `starts` of a task; None for one a core.
        scheduler: Of a Dask cluster, in place of them.

    Returns:
        Table `samples`: the motion, with the columns of a simulation. Table `goals`, a row a goal.
        Table `nodes`, a row a node of the mesh. Metadata: `cost`, `converged`, `error` between
        nodes, how far bounds are `passed` there, `replay`, the deviation of a simulation,
        `active`, and `parameters`.

    Raises:
        NotConvergedError: No solution was found; says what stands against it. Its `result` is the
            last iterate.
        SceneError: The task cannot be read, or does not fit the scene.
    """
    remarks: list[str] = []
    with watching(progress):
        asked = task_of(scene, task)
        where = where_of(scene, task, workers, scheduler)
        found, result = run_predict(scene, asked, say or remarks.append, where)
    if say is None:
        result.metadata["remarks"] = remarks
    if not found.is_converged:
        raise NotConvergedError("\n".join(reasons(found, asked)), result)
    return result


def run_predict(
    scene: Scene, task: PredictTask, say: Say, where: Where = HERE
) -> tuple[Found, Result]:
    """Do what `predict` describes; gives the last iterate where there is no solution."""
    steps = search(scene, task, say, where)
    found = steps[-1].found
    driven, modes, motions = found.problem.scene, found.problem.modes, found.solution.motions
    names = [one.name for one in found.problem.program.parameters]
    if names:
        driven = with_numbers(
            driven, dict(zip(names, found.solution.parameters.tolist(), strict=True))
        )
        modes = modes_of(driven, task)
    simulation = simulation_of(driven, motions, found.worst)
    again = NOT_AGAIN
    if found.is_converged:
        recording = found.problem.recording
        is_loaded = recording is not None and bool(recording.loaded)
        again = replay(simulation, modes, motions, at_nodes=is_loaded)
    for line in (*remarks_of(found), *solution_lines(found, again)):
        say(line)
    table = motion_table(simulation, modes, motions, is_converged=found.is_converged)
    if found.is_converged:
        more = [one for one in asked_columns(found) if one.name not in table]
        table = Table([*table.columns, *more])
    tables = {
        MAIN: table,
        GOALS: goal_table(found),
        NODES: node_table(found),
    }
    if task.continuation:
        tables[CONTINUATION] = continuation_table(steps)
    if steps[0].starts:
        tables[STARTS] = start_table(steps[0].starts)
    inputs = {"task": task.source or None}
    metadata = metadata_of("predict", driven, inputs, topics_of(simulation.system))
    metadata |= numbers_of(found, again)
    metadata["changes"] = list(found.problem.changes)
    return found, Result(tables, metadata)


def task_of(scene: Scene, task: str | Path | Mapping[str, Any]) -> PredictTask:
    """The task of a file, or of the keys of its section."""
    if isinstance(task, str | Path):
        parts = read_task(task, scene).parts
        found: PredictTask = parts.get("predict") or predict_task({}, str(task))
        return found
    return predict_task(dict(task), "predict")


def remarks_of(found: Found) -> tuple[str, ...]:
    """What is odd about the files of a recording."""
    recording = found.problem.recording
    return () if recording is None else recording.remarks


def numbers_of(found: Found, again: Replay) -> dict[str, Any]:
    """What a result says of how good it is."""
    solved = found.solution.solved
    names = [one.name for one in found.problem.program.parameters]
    return {
        "converged": found.is_converged,
        "status": solved.status,
        "cost": solved.cost,
        "duration": [motion.duration for motion in found.solution.motions],
        "error": found.worst,
        "passed": max((one.relative for one in found.passings), default=0.0),
        "violation": solved.violation,
        "stationarity": solved.stationarity,
        "iterations": found.iterations,
        "replay": again.deviation if again.deviation == again.deviation else None,
        "residuals": {one.name: [one.rms, one.largest] for one in residuals_of(found)},
        "active": [list(one) for one in active(found)],
        "parameters": dict(zip(names, found.solution.parameters.tolist(), strict=True)),
    }


def solution_lines(found: Found, again: Replay) -> Iterator[str]:
    """What is said of a solution."""
    solved = found.solution.solved
    word = "found" if found.is_converged else "NOT CONVERGED, the last iterate"
    T = ", ".join(f"{motion.duration:.9g}" for motion in found.solution.motions)
    yield f"{word}: cost {solved.cost:.12g}, duration {T} s, {found.iterations} iterations"
    names = [one.name for one in found.problem.program.parameters]
    for name, value in zip(names, found.solution.parameters, strict=True):
        yield f"  {name} = {value:.9g}"
    yield (
        f"  violation {solved.violation:.1e}, slope of the Lagrangian {solved.stationarity:.1e}, "
        f"both in usual sizes; error between nodes {found.worst:.1e}"
    )
    yield from (one.line for one in residuals_of(found))
    if found.passings:
        one = max(found.passings, key=lambda each: each.relative)
        yield f"  between nodes {one.name} passes its bound {one.bound:g} by {one.by:.1e}"
    if again.why:
        yield f"  integrated again: {again.why}"
    else:
        recording = found.problem.recording
        what = "each node" if recording is not None and recording.loaded else "the end"
        yield f"  integrated again: {what} is off by {again.deviation:.1e}"


def predict_to(
    scene: Scene,
    task: Path,
    out: Path | None,
    say: Say,
    workers: int | None = None,
    scheduler: str | None = None,
) -> bool:
    """Find a motion, and write it where a place is given; the last iterate where there is none.

    Args:
        task: Task file.
        out: The motion; its suffix chooses the format.
        say: Is told what was found, a line each.
        workers: How many processes try the starts of a task; None for one a core.
        scheduler: Of a Dask cluster, in place of them.

    Returns:
        Whether there is a solution.

    Raises:
        MbdError: Input that cannot be used, or a place that cannot be written to.
    """
    asked = task_of(scene, task)
    if out is not None:
        refuse_overwriting(out, task, scene.path)
        for place in (out, *(beside(out, name) for name in (GOALS, NODES, CONTINUATION, STARTS))):
            check_place(place)
    where = where_of(scene, task, workers, scheduler)
    found, result = run_predict(scene, asked, say, where)
    if not found.is_converged:
        say_all(reasons(found, asked))
    if out is not None:
        write_tables(result, out, say)
    return found.is_converged
