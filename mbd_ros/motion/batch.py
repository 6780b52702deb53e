"""Process several recorded motions with one command, in parallel, with one result each."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mbd_ros.errors import DataError, MbdError
from mbd_ros.files.output_folder import make_folder, place_in
from mbd_ros.files.text_file import refuse_overwriting
from mbd_ros.jobs.progress import Say
from mbd_ros.jobs.workers.opening import do_all, open_workers, watched
from mbd_ros.jobs.workers.task import Task as WorkerTask
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.samples import Task
from mbd_ros.scene.schema.code_permission import is_permitted, permitting

Outcome = tuple[list[str], str]


class Batch(NamedTuple):
    """Motions, and the options that are common to all of them.

    Attributes:
        motions: Tables and bags.
        options: Options of the command alone; any values that JSON holds.
        out: Folder of the results; the result itself where there is one motion.
        wrenches: Table or bag of the external loads of every motion.
        external: External loads of OpenSim (.xml): none, of every motion, or one each.
        time_range: First and last time that is solved [s]; None for all.
        wrench_axes: Recorded axis along each axis of the scene; None: the same.
        derivatives: given, causal, zero-phase or opensim.
        cutoff: Of the filters [Hz]; None: the default of `Derivatives`.
        half_width: Samples on either side of a local zero-phase fit; None without one.
        topic: JointState topic of bags.
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
    scheduler: str | None
    workers: int | None


Work = Callable[[Batch, Say], None]
"""Does the only motion of a batch and says what it did."""


def batch_of(arguments: argparse.Namespace, options: Mapping[str, Any]) -> Batch:
    """Return the batch of a command line."""
    shared = (name for name in Batch._fields if name not in ("motions", "options"))
    fields = {name: getattr(arguments, name) for name in shared}
    return Batch(arguments.motion, options, **fields)


def do_batch(
    batch: Batch,
    work: Work,
    worker: Callable[[Mapping[str, Any]], Outcome],
    say: Say,
    check: Callable[[], None] = lambda: None,
) -> None:
    """Process one motion in this process, or several motions in worker processes.

    Args:
        batch: The motions and options.
        work: Function that processes one motion.
        worker: `do_one` with this `work`, a function that a worker can import.
        say: Function that prints the remarks of one motion, or a summary of each of several.
        check: Function that refuses unusable common options before any motion is processed.

    Raises:
        DataError: Some motions failed; the message names them. Or two results would have the same
            name, or the folder cannot be made; then no motion is processed.
    """
    if len(batch.motions) == 1:
        if batch.scheduler is not None or batch.workers is not None:
            raise DataError("--scheduler and --workers are accepted for several motions only")
        work(batch, say)
        return
    call = f"{worker.__module__}:{worker.__name__}"
    orders = _orders(batch)
    check()
    tasks = [WorkerTask(str(order[0]), call, _argument(batch, *order)) for order in orders]
    make_folder(batch.out)
    failed = []
    with open_workers(batch.scheduler, batch.workers) as workers:
        for task, result in watched(do_all(workers, tasks), tasks, workers.count):
            lines, error = result.value or ([], result.failure)
            if error:
                failed.append(f"{task.name}: {error.removeprefix(f'{task.name}: ')}")
            else:
                say(f"{task.name}: {'; '.join(lines)}")
    if failed:
        failures = "\n  ".join(sorted(failed))
        raise DataError(f"{len(failed)} of {len(tasks)} motions failed:\n  {failures}")


def _orders(batch: Batch) -> list[tuple[Path, Path, Path | None]]:
    """Return each motion with its result in the folder and its external loads."""
    results = _places(batch.motions, batch.out)
    externals = _externals(batch)
    for out in results.values():
        refuse_overwriting(out, batch.wrenches, *externals)
    pairs = zip(results.items(), externals, strict=True)
    return [(motion, out, loads) for (motion, out), loads in pairs]


def _places(motions: Sequence[Path], folder: Path) -> dict[Path, Path]:
    """Return motion -> result of the same name, and therefore of the same format."""
    motion_of: dict[Path, Path] = {}
    sources = {motion.resolve() for motion in motions}
    for motion in motions:
        out = place_in(folder.resolve(), motion.resolve().name)
        if out in motion_of:
            raise DataError(
                f"{motion_of[out]} and {motion} have the same name, and so would results"
            )
        if out in sources:
            raise DataError(f"{motion}: its result would overwrite it; choose another folder")
        motion_of[out] = motion
    return {motion: out for out, motion in motion_of.items()}


def _externals(batch: Batch) -> list[Path | None]:
    """Return the external loads of each motion: none, one file for all, or one for each."""
    files, count = batch.external, len(batch.motions)
    if len(files) not in (0, 1, count):
        raise DataError(
            f"--external names {len(files)} files for {count} motions; accepted: one for all, or "
            "one for each"
        )
    return [*files] if len(files) == count else [files[0] if files else None] * count


def _argument(batch: Batch, motion: Path, out: Path, external: Path | None) -> dict[str, Any]:
    """Return a batch of one motion as JSON values, with absolute paths for a cluster."""
    place = Path if batch.scheduler is None else Path.absolute
    fields = batch._asdict() | {"motions": [str(place(motion))], "out": str(out)}
    fields["external"] = [] if external is None else [str(place(external))]
    for name in ("scene", "wrenches"):
        fields[name] = None if fields[name] is None else str(place(fields[name]))
    return {"batch": fields, "allow_code": is_permitted()}


def do_one(argument: Mapping[str, Any], work: Work) -> Outcome:
    """Do one motion in a worker.

    Args:
        argument: `batch` contains the fields of a `Batch` with one motion, with paths as text;
            `allow_code` is whether its scene may import code from outside this package.
        work: Function that processes the motion.

    Returns:
        Remarks, and the error message, or "".
    """
    fields = dict(argument["batch"])
    for name in ("scene", "out", "wrenches"):
        fields[name] = None if fields[name] is None else Path(fields[name])
    fields |= {name: [Path(path) for path in fields[name]] for name in ("motions", "external")}
    lines: list[str] = []
    try:
        with permitting(argument["allow_code"]):
            work(Batch(**fields), lines.append)
    except MbdError as error:
        return lines, str(error)
    return lines, ""


def task_of(batch: Batch) -> Task:
    """Return the task of the only motion of a batch."""
    (motion,) = batch.motions
    (external,) = _externals(batch)
    time_range = None if batch.time_range is None else (batch.time_range[0], batch.time_range[1])
    return Task(
        motion,
        Derivatives(batch.derivatives, batch.cutoff, batch.half_width),
        batch.wrenches,
        batch.topic,
        external=external,
        time_range=time_range,
        wrench_axes=batch.wrench_axes,
    )
