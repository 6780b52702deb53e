"""Many runs of a scene into one table: `mbd-ros simulate --ensemble`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.compiled.build.compiler import cores
from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, MbdError, SceneError
from mbd_ros.features.simulation.job import Interrupted
from mbd_ros.features.simulation.run import Run, check_words
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import MAIN, RUN, TIME, Column, Result, Table
from mbd_ros.files.tables.csv import Numbers, read_table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.progress import Say
from mbd_ros.jobs.workers.opening import do_all, open_workers
from mbd_ros.jobs.workers.task import Result as Done
from mbd_ros.jobs.workers.task import Task, pack, unpack
from mbd_ros.motion.columns import body_columns, joint_columns, whole_bodies
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.runs.batch import Batch, Runs
from mbd_ros.scene.variants import found_place, places_of

_SHARES = 4  # tasks a worker
_SHOWN = 5  # runs that an error names


def ensemble_to(
    scene: Scene,
    run: Run,
    path: Path,
    out: Path,
    say: Say,
    workers: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Simulate from every row of a file and write one table, `run` and `time` first.

    Args:
        run: The order; duration and options count.
        path: Rows, see `read_starts`.
        out: A table; its suffix chooses the format.
        say: Is called with each line of the summary.
        workers: How many cores work at the same time.
        scheduler: Of a Dask cluster.

    Raises:
        Interrupted: Some runs ended early; the table has what they did before.
        MbdError: Input that cannot be used, or a place that cannot be written to.
    """
    refuse_overwriting(out, path)
    if is_bag(out):
        raise DataError(f"-o {out}: --ensemble writes one table: .csv, .csv.gz, .npz or .parquet")
    check_place(out)
    check_words(scene, run)
    starts = read_starts(scene, path)
    options = {**run.options, "dt": min(float(run.options.get("dt", scene.dt)), run.duration)}
    try:
        how, runs = _taken(scene, run.duration, starts, options, (workers, scheduler))
    except MbdError as error:
        raise type(error)(f"{path}: {error}") from error
    say(how)
    table = ensemble_table(scene, runs)
    inputs = {"duration": run.duration, "ensemble": path, **options}
    Result({MAIN: table}, metadata_of("simulate", scene, inputs, {})).to(out)
    say(f"{len(runs.known)} runs, {table.rows} states -> {out}")
    if runs.failures:
        shown = [f"run {i} (line {i + 2}): {e}" for i, e in list(runs.failures.items())[:_SHOWN]]
        more = len(runs.failures) - len(shown)
        shown += [f"and {more} more"] if more else []
        raise Interrupted(
            f"{path}: {len(runs.failures)} of {len(runs.known)} runs ended early: "
            f"{'; '.join(shown)}; what they did before is in {out}, beside the others"
        )


def _taken(
    scene: Scene,
    duration: float,
    starts: Starts,
    options: Mapping[str, Any],
    where: tuple[int | None, str | None],
) -> tuple[str, Runs]:
    """How the runs were taken, and what they did."""
    workers, scheduler = where
    batch = Batch(scene, len(starts.q), parameters=starts.names, threads=workers, **options)
    batch.prepare(starts.p)
    is_spread = scheduler is not None or not (batch.is_side_by_side or workers == 1)
    if len(starts.q) < 2 or scene.path is None or scene.code or not is_spread:
        return batch.how, batch.run(duration, *starts[2:], starts.p if starts.names else None)
    order = {"scene": str(scene.path), "duration": duration, "names": starts.names}
    order["options"] = dict(options)
    with open_workers(scheduler, workers or cores()) as opened:
        size = -(-len(starts.q) // (_SHARES * max(opened.count, 1)))
        firsts = range(0, len(starts.q), size)
        tasks = [
            Task(f"runs {first}", f"{__name__}:take", order | _part(starts, first, size))
            for first in firsts
        ]
        found = {task.name: result for task, result in do_all(opened, tasks)}
    return batch.how, _joined([found[task.name] for task in tasks], list(firsts))


def _part(starts: Starts, first: int, size: int) -> dict[str, Any]:
    some = slice(first, first + size)
    return {name: getattr(starts, name)[some].tolist() for name in "pqvz"}


def _joined(found: Sequence[Done], firsts: Sequence[int]) -> Runs:
    """The runs of all tasks, in their order.

    Raises:
        DataError: A task has failed.
    """
    failures: dict[int, MbdError] = {}
    for first, done in zip(firsts, found, strict=True):
        if done.failure:
            raise DataError(f"runs from {first} on: {done.failure}")
        failures |= {first + i: MbdError(text) for i, text in done.value["failures"]}
    return Runs(
        np.concatenate([unpack(done.value["states"]) for done in found]),
        np.concatenate([np.array(done.value["known"], np.int64) for done in found]),
        failures,
    )


def ensemble_table(scene: Scene, runs: Runs) -> Table:
    """Columns `run`, counted from 0, `time`, joints, free bodies, internal states."""
    n, samples, _ = runs.states.shape
    is_known = np.arange(samples) < runs.known[:, None]
    rows, number = runs.states[is_known], np.repeat(np.arange(n), runs.known)
    robot, model = scene.robot, scene.robot.model
    q, v, z = np.split(rows[:, 1:], (model.nq, model.nq + model.nv), axis=1)
    joints, internals = robot.joints, scene.internals
    return Table(
        [
            Column(RUN, number),
            Column(TIME, rows[:, 0], "s"),
            *joint_columns(joints, "position", q[:, [joint.q for joint in joints]]),
            *joint_columns(joints, "velocity", v[:, [joint.v for joint in joints]]),
            *body_columns(robot, whole_bodies(robot, q, v, None)),
            *(
                Column(name, column, unit)
                for name, unit, column in zip(internals.names, internals.units, z.T, strict=True)
            ),
        ]
    )


def read_starts(scene: Scene, path: Path) -> Starts:
    """The rows of a CSV file; what has no column is that of the scene.

    Args:
        path: Has columns `<joint>.position`, `<joint>.velocity`, those of poses and twists of free
            bodies, internal states, and `<part>.<argument>` as `Scene.with_` takes them.

    Raises:
        DataError: Names file, column and what is accepted.
    """
    read = read_table(path, has_times=False)
    x, count = scene.initial, len(read.values)
    q, v, z = (np.tile(one, (count, 1)) for one in (x.q, x.v, x.z))
    taken = set(_fill(scene, read, q, v, z))
    robot = scene.robot
    for row in range(count):
        scene.couplings.expand(q[row], v[row], np.zeros(robot.model.nv))
    names = tuple(name for name in read.columns if name not in taken)
    places = places_of(scene)
    for name in names:
        try:
            is_of_part = found_place(scene.origin, places, name)[0].at is not None
        except SceneError as error:
            raise DataError(
                f"{path}: column {name}: {error}; accepted are also {_accepted(scene)}"
            ) from error
        if not is_of_part:
            raise DataError(f"{path}: column {name}: is no number of a part")
    return Starts(names, read.values[:, [read.columns.index(name) for name in names]], q, v, z)


def _fill(scene: Scene, read: Numbers, q: Array, v: Array, z: Array) -> Iterator[str]:
    """Writes the states of a file into rows; names of the columns that are states."""
    values = dict(zip(read.columns, read.values.T, strict=True))
    robot, free = scene.robot, set(scene.couplings.independent)
    for joint in robot.joints:
        for name, rows, at in (("position", q, joint.q), ("velocity", v, joint.v)):
            column = f"{joint.name}.{name}"
            if column in values and joint.name not in free:
                raise DataError(f"{read.path}: column {column}: the joint depends on another one")
            if column in values:
                rows[:, at] = values[column]
                yield column
    for base in robot.bases:
        for words, rows, place in ((POSE, q, base.q), (TWIST, v, base.v)):
            names = names_of(base.name, words)
            lacking = [name for name in names if name not in values]
            if len(lacking) == len(names):
                continue
            if lacking:
                raise DataError(f"{read.path}: no column {', '.join(lacking)}, beside {names[0]}")
            given = np.column_stack([values[name] for name in names])
            rows[:, place] = configuration_of(robot, given) if words is POSE else given
            yield from names
    for i, name in enumerate(scene.internals.names):
        if name in values:
            z[:, i] = values[name]
            yield name


def _accepted(scene: Scene) -> str:
    joints = ", ".join(scene.couplings.independent)
    internals = "".join(f", {name}" for name in scene.internals.names)
    return f".position and .velocity of {joints}{internals}"


class Starts(NamedTuple):
    """What differs from run to run, a row a run.

    Attributes:
        names: Names of the parameters.
        q: Configurations of all joints.
        z: Internal states, NaN for their equilibrium.
    """

    names: tuple[str, ...]
    p: Array
    q: Array
    v: Array
    z: Array


def take(order: Mapping[str, Any]) -> dict[str, Any]:
    """Some of the runs, in a worker.

    Args:
        order: Scene, duration, options, names of the parameters, and rows.
    """
    scene, count = load_scene(order["scene"]), len(order["q"])
    names = tuple(order["names"])
    batch = Batch(scene, count, parameters=names, threads=1, **order["options"])
    rows = [np.array(order[name], dtype=np.float64).reshape(count, -1) for name in "qvz"]
    p = np.array(order["p"], dtype=np.float64).reshape(count, -1) if names else None
    runs = batch.run(order["duration"], *rows, p)
    return {
        "states": pack(runs.states),
        "known": runs.known.tolist(),
        "failures": [[i, str(error)] for i, error in runs.failures.items()],
    }
