"""The best motion of a scene: `mbd-ros predict`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import NotConvergedError
from mbd_ros.features.prediction.modes import modes_of
from mbd_ros.features.prediction.replay import NOT_AGAIN, Replay, replay, simulation_of
from mbd_ros.features.prediction.search import HERE, Where, search, where_of
from mbd_ros.features.prediction.solving import SAVED, STOPPED, Found, accepted_passing
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
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.progress import Say, Watch, say_all, watching
from mbd_ros.jobs.result_files import beside, write_tables
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.motion.state_table import topics_of
from mbd_ros.optimal_control.defects import CLOSING
from mbd_ros.optimal_control.motion_phase import END, START
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.task_reader import read_task
from mbd_ros.scene.variants import with_numbers

_SHOWN = 5
_CAUSES = (CLOSING, START, END)  # blocks of rows that a task or a mechanism asks for
_VIOLATED = 1.0e-6  # in usual sizes
_SPREAD = 1.0e8  # of usual sizes that look odd
_ACCEPTED = "more refinements or intervals in mesh, or a larger tolerance"
_LOCAL = "Infeasible_Problem_Detected"
_WORDS = {
    _LOCAL: "the conditions cannot hold together",
    "Maximum_Iterations_Exceeded": "the largest number of iterations was reached",
    STOPPED: "it was interrupted",
    "Restoration_Failed": "no point nearer to the conditions was found",
    "Invalid_Number_Detected": "the equations gave a value that is not finite",
    "Diverging_Iterates": "the unknowns grow without bound: a goal or a bound is missing",
    "Not_Enough_Degrees_Of_Freedom": "there are more conditions than unknowns",
}


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


def active(found: Found) -> list[Any]:
    """Bounds that are active, most of the time first."""
    from mbd_ros.optimal_control.active_bounds import active_bounds

    every = [
        one
        for i, phase in enumerate(found.problem.program.phases)
        for one in active_bounds(phase, i, found.solution)
    ]
    return sorted(every, key=lambda one: -one.share)


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


def reasons(found: Found, task: PredictTask) -> Iterator[str]:
    """Why there is no solution, a line each; the first one is the summary."""
    solved = found.solution.solved
    where = f"{task.source}: " if task.source else ""
    if solved.is_good and found.is_interrupted:
        yield f"{where}no motion found: it was interrupted between two meshes"
        return
    if solved.is_good:
        after = f"after {task.mesh.refinements} refinements"
        yield f"{where}{'; '.join(_not_fine(found, task))} {after}; accepted: {_ACCEPTED}"
        return
    yield f"{where}no motion found: {_WORDS.get(solved.status, solved.status)}"
    yield from violated(found)
    yield from blocking(found)
    yield from odd_sizes(found)
    yield from kinks(found)
    if solved.status == _LOCAL and task.starts == 1:
        yield "  none is near this guess: another guess, or several starts, may lead further"


def _not_fine(found: Found, task: PredictTask) -> Iterator[str]:
    """What is wrong between the nodes of a mesh whose program is solved."""
    if found.worst > task.tolerance:
        yield f"error between nodes {found.worst:.2g} is above the tolerance {task.tolerance:g}"
    if found.passings and (found.worst <= task.tolerance or found.passings[0].severity > 1.0):
        one = found.passings[0]
        saved = sum(each.saved for each in found.passings)
        yield (
            f"{one.name} passes its {'upper' if one.side > 0 else 'lower'} bound {one.bound:g} "
            f"by {one.by:.2g} between nodes at t = {one.time:.3g} s: {one.relative:.2g} of its "
            f"size, where {accepted_passing(task):.2g} is accepted, and passed bounds save "
            f"{saved:.2g} of the cost, where {SAVED * task.tolerance:.2g} is accepted,"
        )


def violated(found: Found) -> Iterator[str]:
    """Rows that do not hold, the worst of each kind: what, by how much, when.

    Closures of loops and conditions at ends come first: equations of motion that do not hold
    between them are mostly a consequence.
    """
    program, solved, number = found.solution.program, found.solution.solved, -1
    worst = dict[str, tuple[bool, float, str]]()
    for block, rows in zip(program.blocks, program.slices, strict=True):
        number += block.name == "motion"
        if not block.form.rows:
            continue
        values = solved.rows[rows].reshape(block.count, block.form.rows).T
        off = np.maximum(block.lower - values, values - block.upper)
        relative = np.maximum(off, 0.0) / block.size
        for i in range(block.form.rows):
            j = int(relative[i].argmax())
            if relative[i, j] > _VIOLATED:
                text = _row(found, number, block, i, j)
                line = f"  violated: {text}, by {off[i, j]:.3g} ({relative[i, j]:.1e} of its size)"
                row = (block.name in _CAUSES, float(relative[i, j]), line)
                worst[text] = max(worst.get(text, row), row)
    for *_, line in sorted(worst.values(), reverse=True)[:_SHOWN]:
        yield line


def _row(found: Found, number: int, block: Any, row: int, place: int) -> str:
    """What a row is, and when."""
    phase = found.problem.program.phases[max(number, 0)]
    motion = found.solution.motions[max(number, 0)]
    if block.name == "collocation":
        at = int(block.places[0, place])
        return f"continuity of {_unknown(found, at)}"
    if block.name == "bodies":
        return "continuity of the pose of a free body"
    name = phase.row_name(block.name, row)
    if block.name in ("start", "end"):
        return f"{name} at the {block.name}"
    if block.data.size and block.data.shape[0] >= 1 and block.name in ("motion", "bounds"):
        t = motion.begin + motion.duration * float(block.data[0, place])
        return f"{name} at t = {t:.3g} s"
    return name or block.name


def _unknown(found: Found, at: int) -> str:
    pairs = zip(found.problem.program.phases, found.solution.unknowns, strict=True)
    for phase, unknowns in pairs:
        for letter, places in unknowns.nodes.items():
            hit = np.argwhere(places == at)
            if len(hit):
                motion_share = float(unknowns.mesh.knots[hit[0, 0]])
                name = phase.quantities.name_of(letter, int(hit[0, 1]))
                return f"{name} after {100 * motion_share:.0f} % of the phase"
    return "the state"


def blocking(found: Found) -> Iterator[str]:
    """Bounds that are active, most of the time first."""
    for name, side, share, value in active(found)[:_SHOWN]:
        word = "upper" if side > 0 else "lower"
        yield f"  blocks: {name} is at its {word} bound {value:g} at {100 * share:.0f} % of points"


def odd_sizes(found: Found) -> Iterator[str]:
    """Unknowns whose usual sizes are so far apart that rounding may stop the solver."""
    sizes = found.solution.program.sizes[found.solution.program.open]
    if sizes.max(initial=1.0) / sizes.min(initial=1.0) > _SPREAD:
        yield (
            f"  sizes of unknowns lie between {sizes.min():.1e} and {sizes.max():.1e}: other "
            "units, or a guess nearer to the motion, may help"
        )


def kinks(found: Found) -> Iterator[str]:
    """Goals that are nearly kinks where powers change their signs."""
    for phase in found.problem.program.phases:
        for goal in phase.problem.goals:
            if goal.kind == "power":
                yield (
                    f"  goal {goal.name} bends within {goal.options['smoothing']:g} W: a larger "
                    "smoothing, or a goal effort beside it, is easier"
                )
