"""Prediction of the optimal motion of a scene: `mbd-ros predict`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import NotConvergedError
from mbd_ros.features.prediction.modes import build_phase_modes
from mbd_ros.features.prediction.replay import NOT_REPLAYED, Replay, build_input_simulation, replay
from mbd_ros.features.prediction.search import LOCAL, StartWorkers, choose_workers, search
from mbd_ros.features.prediction.solving import SAVED, STOPPED, Prediction, accepted_violation
from mbd_ros.features.prediction.tables import (
    CONTINUATION,
    GOALS,
    NODES,
    STARTS,
    base_residuals,
    continuation_table,
    goal_table,
    motion_table,
    node_table,
    requested_columns,
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

_SHOWN = 5  # lines of a kind, at most
_CAUSES = (CLOSING, START, END)  # blocks of rows that a task or a mechanism requires
_VIOLATED = 1.0e-6  # relative to the size of a row
_SPREAD = 1.0e8  # ratio of sizes of unknowns that slows the solver down
_ADVICE = "allow more refinements or intervals in mesh, or a larger tolerance"
_LOCAL = "Infeasible_Problem_Detected"
_STATUS_TEXTS = {
    _LOCAL: "the constraints are locally infeasible",
    "Maximum_Iterations_Exceeded": "the largest number of iterations was reached",
    STOPPED: "it was interrupted",
    "Restoration_Failed": "no point that violates the constraints less was found",
    "Invalid_Number_Detected": "the equations returned a value that is not finite",
    "Diverging_Iterates": "the unknowns grow without bound, so a goal or a bound is missing",
    "Not_Enough_Degrees_Of_Freedom": "there are more constraints than unknowns",
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
    """Predict the motion of least cost that satisfies bounds and equations of motion.

    Args:
        task: A task file with a section `predict`, or the keys of this section; see
            docs/prediction.md.
        say: Function that is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for progress lines on a terminal.
        workers: Number of processes for the `starts` of a task; None for one per core.
        scheduler: Address of a Dask cluster that replaces these processes.

    Returns:
        Table `samples`: the motion, with the columns of a simulation. Table `goals`: one goal per
        row. Table `nodes`: one node of the mesh per row. Metadata: `cost`, `converged`, `error`
        between nodes, `passed` for the largest violation of a bound between nodes, `replay` for
        the deviation of a simulation, `active_bounds_of` bounds, and `parameters`.

    Raises:
        NotConvergedError: No solution was found; the message tells what prevents it. Its `result`
            contains the last iterate.
        SceneError: The task cannot be read, or does not fit the scene.
    """
    remarks: list[str] = []
    with watching(progress):
        section = read_predict_task(scene, task)
        start_workers = choose_workers(scene, task, workers, scheduler)
        prediction, result = run_predict(scene, section, say or remarks.append, start_workers)
    if say is None:
        result.metadata["remarks"] = remarks
    if not prediction.is_converged:
        raise NotConvergedError("\n".join(failure_lines(prediction, section)), result)
    return result


def run_predict(
    scene: Scene, task: PredictTask, say: Say, start_workers: StartWorkers = LOCAL
) -> tuple[Prediction, Result]:
    """Predict as a task says; without a solution, the result contains the last iterate."""
    steps = search(scene, task, say, start_workers)
    prediction = steps[-1].prediction
    solved_scene, modes = prediction.problem.scene, prediction.problem.modes
    motions = prediction.solution.motions
    names = [parameter.name for parameter in prediction.problem.program.parameters]
    if names:
        values = prediction.solution.parameters.tolist()
        solved_scene = with_numbers(solved_scene, dict(zip(names, values, strict=True)))
        modes = build_phase_modes(solved_scene, task)
    simulation = build_input_simulation(solved_scene, motions, prediction.worst)
    replayed = NOT_REPLAYED
    if prediction.is_converged:
        recording = prediction.problem.recording
        is_loaded = recording is not None and bool(recording.loaded)
        replayed = replay(simulation, modes, motions, at_nodes=is_loaded)
    for line in (*recording_remarks(prediction), *solution_lines(prediction, replayed)):
        say(line)
    table = motion_table(simulation, modes, motions, is_converged=prediction.is_converged)
    if prediction.is_converged:
        more = [column for column in requested_columns(prediction) if column.name not in table]
        table = Table([*table.columns, *more])
    tables = {
        MAIN: table,
        GOALS: goal_table(prediction),
        NODES: node_table(prediction),
    }
    if task.continuation:
        tables[CONTINUATION] = continuation_table(steps)
    if steps[0].starts:
        tables[STARTS] = start_table(steps[0].starts)
    inputs = {"task": task.source or None}
    metadata = metadata_of("predict", solved_scene, inputs, topics_of(simulation.system))
    metadata |= quality_metadata(prediction, replayed)
    metadata["changes"] = list(prediction.problem.changes)
    return prediction, Result(tables, metadata)


def predict_to(
    scene: Scene,
    task: Path,
    out: Path | None,
    say: Say,
    workers: int | None = None,
    scheduler: str | None = None,
) -> bool:
    """Predict a motion and write it, or the last iterate without a solution, if `out` is given.

    Args:
        out: File for the motion; its suffix selects the format.
        say: Receives lines for people.
        workers: Number of processes for the starts of a task; None for one per core.
        scheduler: Address of a Dask cluster that replaces these processes.

    Returns:
        Whether there is a solution.

    Raises:
        MbdError: The input cannot be used, or the file cannot be written.
    """
    section = read_predict_task(scene, task)
    if out is not None:
        refuse_overwriting(out, task, scene.path)
        for place in (out, *(beside(out, name) for name in (GOALS, NODES, CONTINUATION, STARTS))):
            check_place(place)
    start_workers = choose_workers(scene, task, workers, scheduler)
    prediction, result = run_predict(scene, section, say, start_workers)
    if not prediction.is_converged:
        say_all(failure_lines(prediction, section))
    if out is not None:
        write_tables(result, out, say)
    return prediction.is_converged


def read_predict_task(scene: Scene, task: str | Path | Mapping[str, Any]) -> PredictTask:
    """Return the task of a file, or of the keys of its section."""
    if isinstance(task, str | Path):
        parts = read_task(task, scene).parts
        section: PredictTask = parts.get("predict") or predict_task({}, str(task))
        return section
    return predict_task(dict(task), "predict")


def recording_remarks(prediction: Prediction) -> tuple[str, ...]:
    """Return remarks on the files of a recording."""
    recording = prediction.problem.recording
    return () if recording is None else recording.remarks


def quality_metadata(prediction: Prediction, replayed: Replay) -> dict[str, Any]:
    """Return metadata about the quality of a solution."""
    solved = prediction.solution.solved
    names = [parameter.name for parameter in prediction.problem.program.parameters]
    return {
        "converged": prediction.is_converged,
        "status": solved.status,
        "cost": solved.cost,
        "duration": [motion.duration for motion in prediction.solution.motions],
        "error": prediction.worst,
        "passed": max(
            (violation.relative for violation in prediction.bound_violations), default=0.0
        ),
        "violation": solved.violation,
        "stationarity": solved.stationarity,
        "iterations": prediction.iterations,
        "replay": replayed.deviation if replayed.deviation == replayed.deviation else None,
        "residuals": {r.name: [r.rms, r.largest] for r in base_residuals(prediction)},
        "active": [list(bound) for bound in active_bounds_of(prediction)],
        "parameters": dict(zip(names, prediction.solution.parameters.tolist(), strict=True)),
    }


def active_bounds_of(prediction: Prediction) -> list[Any]:
    """Return the active bounds, those that are active at most points first."""
    from mbd_ros.optimal_control.active_bounds import active_bounds

    bounds = [
        bound
        for i, phase in enumerate(prediction.problem.program.phases)
        for bound in active_bounds(phase, i, prediction.solution)
    ]
    return sorted(bounds, key=lambda bound: -bound.share)


def solution_lines(prediction: Prediction, replayed: Replay) -> Iterator[str]:
    """Yield lines for people about a solution."""
    solved = prediction.solution.solved
    word = "found" if prediction.is_converged else "NOT CONVERGED, the last iterate"
    T = ", ".join(f"{motion.duration:.9g}" for motion in prediction.solution.motions)
    yield f"{word}: cost {solved.cost:.12g}, duration {T} s, {prediction.iterations} iterations"
    names = [parameter.name for parameter in prediction.problem.program.parameters]
    for name, value in zip(names, prediction.solution.parameters, strict=True):
        yield f"  {name} = {value:.9g}"
    yield (
        f"  violation {solved.violation:.1e}, gradient of the Lagrangian "
        f"{solved.stationarity:.1e}, both relative to sizes; error between nodes "
        f"{prediction.worst:.1e}"
    )
    yield from (residual.line for residual in base_residuals(prediction))
    if prediction.bound_violations:
        worst = max(prediction.bound_violations, key=lambda violation: violation.relative)
        yield f"  between nodes {worst.name} passes its bound {worst.bound:g} by {worst.by:.1e}"
    if replayed.why:
        yield f"  simulated again: {replayed.why}"
    else:
        recording = prediction.problem.recording
        place = "each node" if recording is not None and recording.loaded else "the end"
        yield f"  simulated again: {place} is off by {replayed.deviation:.1e}"


def failure_lines(prediction: Prediction, task: PredictTask) -> Iterator[str]:
    """Yield lines about why there is no solution; the first one is the summary."""
    solved = prediction.solution.solved
    prefix = f"{task.source}: " if task.source else ""
    if solved.is_good and prediction.is_interrupted:
        yield f"{prefix}no motion found: it was interrupted between two meshes"
        return
    if solved.is_good:
        after = f"after {task.mesh.refinements} refinements"
        yield f"{prefix}{'; '.join(_mesh_faults(prediction, task))} {after}; {_ADVICE}"
        return
    yield f"{prefix}no motion found: {_STATUS_TEXTS.get(solved.status, solved.status)}"
    yield from violated_lines(prediction)
    yield from active_bound_lines(prediction)
    yield from scaling_lines(prediction)
    yield from smoothing_lines(prediction)
    if solved.status == _LOCAL and task.starts == 1:
        yield "  the solver found none near this guess; try another guess, or several starts"


def _mesh_faults(prediction: Prediction, task: PredictTask) -> Iterator[str]:
    """Yield what is wrong between the nodes of a mesh whose program is solved."""
    if prediction.worst > task.tolerance:
        error = f"error between nodes {prediction.worst:.2g}"
        yield f"{error} is above the tolerance {task.tolerance:g}"
    if prediction.bound_violations and (
        prediction.worst <= task.tolerance or prediction.bound_violations[0].severity > 1.0
    ):
        worst = prediction.bound_violations[0]
        saved = sum(violation.saved for violation in prediction.bound_violations)
        yield (
            f"{worst.name} passes its {'upper' if worst.side > 0 else 'lower'} bound "
            f"{worst.bound:g} by {worst.by:.2g} between nodes at t = {worst.time:.3g} s, which is "
            f"{worst.relative:.2g} of its size, where {accepted_violation(task):.2g} is accepted, "
            f"and violated bounds save {saved:.2g} of the cost, where "
            f"{SAVED * task.tolerance:.2g} is accepted,"
        )


def violated_lines(prediction: Prediction) -> Iterator[str]:
    """Yield lines about constraints that do not hold, the worst of each kind first.

    Closures of loops and conditions at ends come first, because violated equations of motion
    between them are mostly their consequence.
    """
    program, solved, number = prediction.solution.program, prediction.solution.solved, -1
    worst = dict[str, tuple[bool, float, str]]()
    for block, rows in zip(program.blocks, program.slices, strict=True):
        number += block.name == "motion"
        if not block.form.rows:
            continue
        values = solved.rows[rows].reshape(block.count, block.form.rows).T
        error = np.maximum(block.lower - values, values - block.upper)
        relative = np.maximum(error, 0.0) / block.size
        for i in range(block.form.rows):
            j = int(relative[i].argmax())
            if relative[i, j] > _VIOLATED:
                text = _row(prediction, number, block, i, j)
                size = f"{relative[i, j]:.1e} of its size"
                line = f"  violated: {text}, by {error[i, j]:.3g} ({size})"
                row = (block.name in _CAUSES, float(relative[i, j]), line)
                worst[text] = max(worst.get(text, row), row)
    for *_, line in sorted(worst.values(), reverse=True)[:_SHOWN]:
        yield line


def _row(prediction: Prediction, number: int, block: Any, row: int, place: int) -> str:
    """Return what a row states, and when."""
    phase = prediction.problem.program.phases[max(number, 0)]
    motion = prediction.solution.motions[max(number, 0)]
    if block.name == "collocation":
        return f"continuity of {_unknown(prediction, int(block.places[0, place]))}"
    if block.name == "bodies":
        return "continuity of the pose of a free body"
    name = phase.row_name(block.name, row)
    if block.name in ("start", "end"):
        return f"{name} at the {block.name}"
    if block.data.size and block.data.shape[0] >= 1 and block.name in ("motion", "bounds"):
        t = motion.begin + motion.duration * float(block.data[0, place])
        return f"{name} at t = {t:.3g} s"
    return name or block.name


def _unknown(prediction: Prediction, index: int) -> str:
    """Return the name of an unknown at a node."""
    pairs = zip(prediction.problem.program.phases, prediction.solution.unknowns, strict=True)
    for phase, unknowns in pairs:
        for letter, places in unknowns.nodes.items():
            hit = np.argwhere(places == index)
            if len(hit):
                motion_share = float(unknowns.mesh.knots[hit[0, 0]])
                name = phase.quantities.name_of(letter, int(hit[0, 1]))
                return f"{name} after {100 * motion_share:.0f} % of the phase"
    return "the state"


def active_bound_lines(prediction: Prediction) -> Iterator[str]:
    """Yield lines about active bounds, those that are active at most points first."""
    for name, side, share, value in active_bounds_of(prediction)[:_SHOWN]:
        word = "upper" if side > 0 else "lower"
        yield f"  blocks: {name} is at its {word} bound {value:g} at {100 * share:.0f} % of points"


def scaling_lines(prediction: Prediction) -> Iterator[str]:
    """Yield a line if sizes of unknowns differ so much that rounding may stop the solver."""
    sizes = prediction.solution.program.sizes[prediction.solution.program.open]
    if sizes.max(initial=1.0) / sizes.min(initial=1.0) > _SPREAD:
        yield (
            f"  sizes of unknowns lie between {sizes.min():.1e} and {sizes.max():.1e}; try other "
            "units, or a guess nearer to the motion"
        )


def smoothing_lines(prediction: Prediction) -> Iterator[str]:
    """Yield lines about goals that are nearly not differentiable where powers change sign."""
    for phase in prediction.problem.program.phases:
        for goal in phase.problem.goals:
            if goal.kind == "power":
                yield (
                    f"  goal {goal.name} is smoothed within {goal.options['smoothing']:g} W; try "
                    "a larger smoothing, or an additional goal of type effort"
                )
