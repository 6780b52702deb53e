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
from mbd_ros.features.simulation.run import Run, check_run
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

_TASKS_PER_WORKER = 4
_MOST_NAMED = 5  # runs in an error


def ensemble_to(
    scene: Scene,
    run: Run,
    path: Path,
    out: Path,
    say: Say,
    workers: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Simulate a run for each row of a file, and write one table with `run` and `time` first.

    Args:
        scene: The scene.
        run: The order, of which duration and options apply.
        path: File of the initial states, as `read_starts` reads it.
        out: Path of the table, whose suffix chooses the format.
        say: Called with each line for people.
        workers: Number of processes; None for one per core.
        scheduler: Address of a Dask cluster in place of processes of this machine.

    Raises:
        Interrupted: Some runs ended early; the table has their states so far.
        MbdError: An input cannot be used, or a file cannot be written.
    """
    refuse_overwriting(out, path)
    if is_bag(out):
        raise DataError(f"-o {out}: --ensemble writes one table: .csv, .csv.gz, .npz or .parquet")
    check_place(out)
    check_run(scene, run)
    starts = read_starts(scene, path)
    options = {**run.options, "dt": min(float(run.options.get("dt", scene.dt)), run.duration)}
    try:
        how, runs = _simulate(scene, run.duration, starts, options, (workers, scheduler))
    except MbdError as error:
        raise type(error)(f"{path}: {error}") from error
    say(how)
    table = ensemble_table(scene, runs)
    inputs = {"duration": run.duration, "ensemble": path, **options}
    Result({MAIN: table}, metadata_of("simulate", scene, inputs, {})).to(out)
    say(f"{len(runs.known)} runs, {table.rows} states -> {out}")
    if runs.failures:
        failures = [
            f"run {i} (line {i + 2}): {e}" for i, e in list(runs.failures.items())[:_MOST_NAMED]
        ]
        more = len(runs.failures) - len(failures)
        failures += [f"and {more} more"] if more else []
        raise Interrupted(
            f"{path}: {len(runs.failures)} of {len(runs.known)} runs ended early: "
            f"{'; '.join(failures)}; their states so far are in {out}, with the other runs"
        )


def _simulate(
    scene: Scene,
    duration: float,
    starts: Starts,
    options: Mapping[str, Any],
    where: tuple[int | None, str | None],
) -> tuple[str, Runs]:
    """Simulate all runs; also return a line about the method."""
    workers, scheduler = where
    batch = Batch(scene, len(starts.q), parameters=starts.names, threads=workers, **options)
    batch.prepare(starts.p)
    is_spread = scheduler is not None or not (batch.is_side_by_side or workers == 1)
    if len(starts.q) < 2 or scene.path is None or scene.code or not is_spread:
        return batch.how, batch.run(duration, *starts[2:], starts.p if starts.names else None)
    order = {"scene": str(scene.path), "duration": duration, "names": starts.names}
    order["options"] = dict(options)
    with open_workers(scheduler, workers or cores()) as opened:
        size = -(-len(starts.q) // (_TASKS_PER_WORKER * max(opened.count, 1)))
        firsts = range(0, len(starts.q), size)
        tasks = [
            Task(f"runs {first}", f"{__name__}:take", order | _part(starts, first, size))
            for first in firsts
        ]
        results = {task.name: result for task, result in do_all(opened, tasks)}
    return batch.how, _join([results[task.name] for task in tasks], list(firsts))


def _part(starts: Starts, first: int, size: int) -> dict[str, Any]:
    some = slice(first, first + size)
    return {name: getattr(starts, name)[some].tolist() for name in "pqvz"}


def _join(results: Sequence[Done], firsts: Sequence[int]) -> Runs:
    """Join the runs of all tasks in their order.

    Raises:
        DataError: A task has failed.
    """
    failures: dict[int, MbdError] = {}
    for first, done in zip(firsts, results, strict=True):
        if done.failure:
            raise DataError(f"runs from {first} on: {done.failure}")
        failures |= {first + i: MbdError(text) for i, text in done.value["failures"]}
    return Runs(
        np.concatenate([unpack(done.value["states"]) for done in results]),
        np.concatenate([np.array(done.value["known"], np.int64) for done in results]),
        failures,
    )


def ensemble_table(scene: Scene, runs: Runs) -> Table:
    """Return columns `run`, counted from 0, `time`, joints, free bodies and internal states."""
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
    """Read the initial states and parameters of runs from a CSV file.

    Args:
        scene: The scene, whose values are those of missing columns.
        path: File with columns `<joint>.position`, `<joint>.velocity`, those of poses and twists
            of free bodies, internal states, and `<part>.<argument>` as `Scene.with_` takes them.

    Raises:
        DataError: A column is not accepted; the message names file, column and accepted names.
    """
    read = read_table(path, has_times=False)
    x, count = scene.initial, len(read.values)
    q, v, z = (np.tile(values, (count, 1)) for values in (x.q, x.v, x.z))
    states = set(_fill(scene, read, q, v, z))
    robot = scene.robot
    for row in range(count):
        scene.couplings.expand(q[row], v[row], np.zeros(robot.model.nv))
    names = tuple(name for name in read.columns if name not in states)
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
    """Write the states of a file into rows, and yield the names of their columns."""
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
        for components, rows, place in ((POSE, q, base.q), (TWIST, v, base.v)):
            names = names_of(base.name, components)
            missing = [name for name in names if name not in values]
            if len(missing) == len(names):
                continue
            if missing:
                raise DataError(f"{read.path}: no column {', '.join(missing)}, beside {names[0]}")
            state = np.column_stack([values[name] for name in names])
            rows[:, place] = configuration_of(robot, state) if components is POSE else state
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
    """Initial states and parameters of n runs.

    Attributes:
        names: Names of the parameters.
        p: Parameters, shape (n, len(names)).
        q: Configurations of all joints, shape (n, nq).
        v: Velocities of all joints, shape (n, nv).
        z: Internal states, NaN for their equilibrium, shape (n, nz).
    """

    names: tuple[str, ...]
    p: Array
    q: Array
    v: Array
    z: Array


def take(order: Mapping[str, Any]) -> dict[str, Any]:
    """Simulate some of the runs in a worker process.

    Args:
        order: Scene, duration, options, names of the parameters, and rows of the runs.
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
