"""Muscle forces of several motions, one each on a core or on a cluster."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mbd_ros.errors import DataError
from mbd_ros.features.muscles.job import Sharing, muscles_to
from mbd_ros.features.muscles.task import muscles_task
from mbd_ros.jobs.progress import Say
from mbd_ros.jobs.result_files import Outcome, do_motions, externals_of, orders_of, outcome_of
from mbd_ros.jobs.workers.task import Task as WorkerTask
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.samples import Task
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import is_permitted

_PATHS = ("scene", "out", "wrenches", "task")


class Batch(NamedTuple):
    """Order of a batch.

    Attributes:
        motions: Tables and bags.
        options: Keys of the section `muscles` of a task file.
        scene: The scene.
        out: Folder of the results; the result itself where there is one motion.
        wrenches: Table or bag of the external loads of every motion.
        external: External loads of OpenSim (.xml): none, of every motion, or one each.
        time_range: First and last time that is solved [s]; None for all.
        wrench_axes: Recorded axis along each axis of the scene; None: the same.
        derivatives: given, causal, zero-phase or opensim.
        cutoff: Of the filters [Hz].
        half_width: Samples on either side of a local zero-phase fit.
        topic: JointState topic of bags.
        task: Task file whose section `muscles` says what the options leave out.
        scheduler: Of a Dask cluster; None for processes of this machine.
        workers: How many processes; None for one a core.
    """

    motions: Sequence[Path]
    options: Mapping[str, Any]
    scene: Path
    out: Path
    wrenches: Path | None
    external: Sequence[Path]
    time_range: Sequence[float] | None
    wrench_axes: str | None
    derivatives: str
    cutoff: float | None
    half_width: int | None
    topic: str
    task: Path | None
    scheduler: str | None
    workers: int | None


def muscles_of_one(batch: Batch, say: Say) -> None:
    """Do the only motion; `say` is told of it."""
    if batch.scheduler is not None or batch.workers is not None:
        raise DataError("--scheduler and --workers go with several motions")
    _muscles(batch, load_scene(batch.scene), say)


def muscles_of_all(batch: Batch, say: Say) -> None:
    """Do all motions, each into a file or folder of its own name below `batch.out`.

    Args:
        batch: The motions.
        say: Is told the summary of every motion, as they end.

    Raises:
        DataError: Motions that failed, by name, when the others are done; before any is done
            names that would meet in the folder, or a folder that cannot be.
    """
    orders = orders_of(batch.motions, batch.out, batch.wrenches, batch.external)
    _options(batch, load_scene(batch.scene))
    tasks = [_work(batch, *order) for order in orders]
    do_motions(tasks, batch.out, batch.scheduler, batch.workers, say)


def one(argument: Mapping[str, Any]) -> Outcome:
    """One motion, in a worker.

    Args:
        argument: `batch`, the fields of a `Batch` with one motion, paths as text; `allow_code`,
            whether its scene may name code of others.

    Returns:
        Its lines, and why it failed.
    """
    fields = dict(argument["batch"])
    for name in _PATHS:
        fields[name] = None if fields[name] is None else Path(fields[name])
    fields |= {name: [Path(path) for path in fields[name]] for name in ("motions", "external")}
    batch = Batch(**fields)
    return outcome_of(
        lambda say: _muscles(batch, load_scene(batch.scene), say), argument["allow_code"]
    )


def _muscles(batch: Batch, scene: Scene, say: Say) -> None:
    derivatives = Derivatives(batch.derivatives, batch.cutoff, batch.half_width)
    (motion,) = batch.motions
    (external,) = externals_of(batch.external, 1)
    between = None if batch.time_range is None else (batch.time_range[0], batch.time_range[1])
    given = motion, derivatives, batch.wrenches, batch.topic
    more = {"external": external, "time_range": between, "wrench_axes": batch.wrench_axes}
    task = Task(*given, **more)
    options = _options(batch, scene)
    asked = muscles_task(scene, options, "muscles")
    muscles_to(scene, Sharing(task, asked, options), batch.out, say)


def _options(batch: Batch, scene: Scene) -> dict[str, Any]:
    """Options of the command, and else of the task file; checked."""
    options: dict[str, Any] = {}
    if batch.task is not None:
        from mbd_ros.scene.task_reader import read_task

        entry = read_task(batch.task, scene).entries.get("muscles")
        if entry is None:
            raise DataError(f"--task {batch.task}: has no section muscles")
        options = dict(entry)
        for key in ("emg", "reserves"):  # relative to the task file
            if isinstance(options.get(key), str):
                options[key] = str((batch.task.parent / options[key]).absolute())
    options |= batch.options
    muscles_task(scene, options, "muscles").solver(scene)
    return options


def _work(batch: Batch, motion: Path, out: Path, external: Path | None) -> WorkerTask:
    place = Path if batch.scheduler is None else Path.absolute
    fields = batch._asdict() | {"motions": [str(place(motion))], "out": str(out)}
    fields["external"] = [] if external is None else [str(place(external))]
    for name in ("scene", "wrenches", "task"):
        fields[name] = None if fields[name] is None else str(place(fields[name]))
    argument = {"batch": fields, "allow_code": is_permitted()}
    return WorkerTask(str(motion), f"{__name__}:{one.__name__}", argument)
