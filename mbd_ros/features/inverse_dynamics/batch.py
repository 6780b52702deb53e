"""Inverse dynamics of many motions, a result each: `mbd-ros inverse SCENE MOTION MOTION ..`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mbd_ros.errors import DataError
from mbd_ros.features.inverse_dynamics.job import inverse_to
from mbd_ros.jobs.progress import Say
from mbd_ros.jobs.result_files import Outcome, do_motions, externals_of, orders_of, outcome_of
from mbd_ros.jobs.workers.task import Task as WorkerTask
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.external_loads import refuse_unused
from mbd_ros.motion.samples import Task
from mbd_ros.motion.unmeasured_contacts import stance_of
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import is_permitted


class Batch(NamedTuple):
    """Order of a batch.

    Attributes:
        motions: Tables and bags.
        scene: The scene.
        out: Folder of the results; the result itself where there is one motion.
        wrenches: Table or bag of the external loads of every motion.
        external: External loads of OpenSim (.xml): none, of every motion, or one each.
        time_range: First and last time that is solved [s]; None for all.
        wrench_axes: Recorded axis along each axis of the scene; None: the same.
        derivatives: given, causal, zero-phase or opensim.
        cutoff: Of the filters [Hz]; None: the default of `Derivatives`.
        half_width: Samples on either side of a local zero-phase fit; None without one.
        topic: JointState topic of bags.
        parts: Also write the torques by cause.
        bounds: Keep the bounds of efforts and multipliers.
        power: Also write the powers.
        stance: What decides on forces of contacts that nobody measured; None takes 0 for them.
        stance_gap: Largest gap of what is on the ground [-]; None: the default of `Nearness`.
        stance_speed: Largest speed of it along the normal [-]; likewise.
        scheduler: Of a Dask cluster; None for processes of this machine.
        workers: How many processes; None for one a core.
    """

    motions: Sequence[Path]
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
    parts: bool
    bounds: bool
    power: bool
    stance: str | None
    stance_gap: float | None
    stance_speed: float | None
    scheduler: str | None
    workers: int | None


def inverse_of_one(batch: Batch, say: Say) -> None:
    """Do the only motion; `say` is told of it."""
    if batch.scheduler is not None or batch.workers is not None:
        raise DataError("--scheduler and --workers go with several motions")
    externals_of(batch.external, len(batch.motions))
    _inverse(batch, say)


def inverse_of_all(batch: Batch, say: Say) -> None:
    """Do all motions, each into a file or folder of its own name below `batch.out`.

    Args:
        batch: The motions.
        say: Is told the summary of every motion, as they end.

    Raises:
        DataError: Motions that failed, by name, when the others are done; before any is done
            names that would meet in the folder, or a folder that cannot be.
    """
    orders = orders_of(batch.motions, batch.out, batch.wrenches, batch.external)
    refuse_unused(load_scene(batch.scene), batch.wrenches)
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
    for name in ("scene", "out", "wrenches"):
        fields[name] = None if fields[name] is None else Path(fields[name])
    fields |= {name: [Path(path) for path in fields[name]] for name in ("motions", "external")}
    batch = Batch(**fields)
    return outcome_of(lambda say: _inverse(batch, say), argument["allow_code"])


def _inverse(batch: Batch, say: Say) -> None:
    derivatives = Derivatives(batch.derivatives, batch.cutoff, batch.half_width)
    (motion,) = batch.motions
    between = None if batch.time_range is None else (batch.time_range[0], batch.time_range[1])
    (external,) = externals_of(batch.external, len(batch.motions))
    more = batch.topic, batch.parts, batch.bounds, external, between, batch.power
    stance = stance_of(batch.stance, batch.stance_gap, batch.stance_speed)
    asked = Task(motion, derivatives, batch.wrenches, *more, stance, batch.wrench_axes)
    inverse_to(load_scene(batch.scene), asked, batch.out, say)


def _work(batch: Batch, motion: Path, out: Path, external: Path | None) -> WorkerTask:
    place = Path if batch.scheduler is None else Path.absolute
    fields = batch._asdict() | {"motions": [str(place(motion))], "out": str(out)}
    fields["external"] = [] if external is None else [str(place(external))]
    for name in ("scene", "wrenches"):
        fields[name] = None if fields[name] is None else str(place(fields[name]))
    argument = {"batch": fields, "allow_code": is_permitted()}
    return WorkerTask(str(motion), f"{__name__}:{one.__name__}", argument)
