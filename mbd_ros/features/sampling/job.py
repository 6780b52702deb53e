"""Ensembles of a scene: `mbd-ros sample`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, DivergedError, SceneError
from mbd_ros.features.sampling.chains import (
    Asked,
    Order,
    Sampled,
    blocks_of,
    packed_block,
    packed_checkpoint,
    read_checkpoint,
    unpacked_block,
    unpacked_checkpoint,
    write_checkpoint,
)
from mbd_ros.features.sampling.components import components
from mbd_ros.features.sampling.ensemble import degrees_of_freedom
from mbd_ros.features.sampling.mean_force import (
    Average,
    Histogram,
    MeanForce,
    Profile,
    average,
    free_energy,
    histogram,
    mean_force,
)
from mbd_ros.features.sampling.task import HISTOGRAM, PROFILE, SampleTask, sample_task
from mbd_ros.files.formats import PICTURES, format_of, suffix_of
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.progress import Say, Watch, watching
from mbd_ros.jobs.result_files import write_tables
from mbd_ros.jobs.workers.opening import do_all, open_workers, watched
from mbd_ros.jobs.workers.task import Task
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.scene.reader import load_any
from mbd_ros.scene.task_reader import read_task

AVERAGES = "averages"
CHAINS = "chains"
_AVERAGE = (  # columns of an average, and whether they have the unit of the quantity
    ("mean", True),
    ("standard_error", True),
    ("standard_deviation", True),
    ("autocorrelation_time", False),
    ("effective_samples", False),
    ("split_rhat", False),
)
_APART = 1.05  # split R-hat above which chains are said not to agree
_BINS = 20
_FEW = 100  # effective samples


class Where(NamedTuple):
    """Processes that sample chains, and checkpoints.

    Attributes:
        workers: Number of processes; None for one per core.
        scheduler: Address of a Dask cluster in place of processes of this machine.
        goes_on: Checkpoint of an earlier run, which this run continues.
        checkpoint: File for the checkpoint of this run.
    """

    workers: int | None = None
    scheduler: str | None = None
    goes_on: Path | None = None
    checkpoint: Path | None = None


_HERE = Where()


def sample(
    scene: Any,
    task: str | Path | Mapping[str, Any],
    *,
    workers: int | None = 1,
    scheduler: str | None = None,
    goes_on: str | Path | None = None,
    checkpoint: str | Path | None = None,
    say: Say | None = None,
    progress: Watch = False,
) -> Result:
    """Sample the canonical ensemble of a scene, or compute mean forces along a coordinate.

    Args:
        scene: A scene of particles, or a mechanism without free bodies.
        task: A task file with a section `sample`, or the keys of that section: the arguments of
            `mbd_ros.features.sampling.task.SampleTask`.
        workers: Number of processes, which does not change the result; None for one per core. A
            script starts several only below `if __name__ == "__main__":`.
        scheduler: Address of a Dask cluster in place of processes of this machine.
        goes_on: Checkpoint (.npz) of an earlier run, which this run continues.
        checkpoint: File (.npz) for the states of the chains at the end of the run.
        say: Called with each line for people; without it the lines go to `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.

    Returns:
        Tables `samples`, `averages`, `chains` and `histogram.<quantity>`; with a coordinate the
        table `profile`.

    Raises:
        SceneError: The task cannot be read, or does not fit the scene.
        DivergedError: A step does not end on the constraints.
    """
    remarks: list[str] = []
    paths = (None if one is None else Path(one) for one in (goes_on, checkpoint))
    where = Where(workers, scheduler, *paths)
    with watching(progress):
        result = run_sample(Asked(scene, *task_of(scene, task)), say or remarks.append, where)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def run_sample(asked: Asked, say: Say, where: Where = _HERE) -> Result:
    """Do what `sample` describes."""
    for line in _first_lines(asked):
        say(line)
    if asked.coordinate is not None:
        found = _profile(asked, say, where)
    else:
        found = _ensemble(asked, say, where)
    inputs = {"seed": asked.plan.seed, "thermal_energy": asked.kT, "method": asked.plan.method}
    return Result(found, metadata_of("sample", asked.scene, inputs, {}))


def _first_lines(asked: Asked) -> Iterator[str]:
    sampled, task = asked.sampled, asked.task
    degrees = degrees_of_freedom(sampled.space, sampled.start)
    yield (
        f"{sampled.name}: {sampled.space.size} coordinates, {degrees} degrees of freedom, "
        f"kT {asked.kT:.6g} {sampled.energy}, {task.method}"
        + (", Fixman's potential" if task.fixman else "")
    )
    looks = sampled.is_small if task.components is None else task.components
    if not looks or asked.coordinate is not None or not sampled.features:
        return
    found = components(asked.ensemble(None), sampled.start, sampled.features, task.seed)
    if found.number == 1:
        yield f"components: 1, from {len(found.of_probe) - 1} random starts"
        return
    own = int(np.count_nonzero(found.of_probe == 0)) - 1
    yield (
        f"components: {found.number} that no motion along the rows joins; "
        f"{own} of {len(found.of_probe) - 1} random starts are in that of the scene"
    )
    yield from (f"  wall: {wall}" for wall in found.walls)


def _profile(asked: Asked, say: Say, where: Where) -> dict[str, Any]:
    if where.goes_on is not None or where.checkpoint is not None:
        raise SceneError("mean forces have no checkpoints; a run without a coordinate has")
    levels, blocks = list(asked.task.at), blocks_of(asked.plan.chains)
    orders = [Order(i, level) for level in levels for i in range(len(blocks))]
    done = blocks_done(asked, orders, where.workers, where.scheduler)
    forces = []
    for k, level in enumerate(levels):
        mine = done[k * len(blocks) : (k + 1) * len(blocks)]
        values = np.concatenate([one.values for one in mine], axis=1)
        forces.append(mean_force(level, *values))
    profile, coordinate = free_energy(forces), asked.coordinate
    assert coordinate is not None
    units = (coordinate.unit, asked.sampled.energy)
    for one, energy, error in zip(forces, *profile, strict=True):
        say(
            f"  {coordinate.name} {one.level:g}: mean force {one.force.mean:.6g} +- "
            f"{one.force.error:.2g}, free energy {energy:.6g} +- {error:.2g} "
            f"({one.force.effective:.0f} effective samples)"
        )
    table = profile_table(coordinate.name, units, forces, profile)
    return {MAIN: table, PROFILE: table}


def blocks_done(
    asked: Asked, orders: Sequence[Order], workers: int | None, scheduler: str | None
) -> list[Sampled]:
    """Blocks of chains, in the order of `orders`, here or by workers.

    Raises:
        DataError: A worker has failed.
        MbdError: A step does not end on the rows, or a held value cannot be reached.
    """
    scene = asked.scene
    alone = scene.path is None or getattr(scene, "code", False) or len(orders) < 2
    if alone or (workers == 1 and scheduler is None):
        return [asked.done(order) for order in orders]
    entries = _entries(asked.task)
    tasks = [
        Task(str(i), f"{__name__}:do", {"scene": str(scene.path), "task": entries} | _sent(order))
        for i, order in enumerate(orders)
    ]
    with open_workers(scheduler, workers) as opened:
        done = {t.name: r for t, r in watched(do_all(opened, tasks), tasks, opened.count)}
    for task in tasks:
        failure = done[task.name].failure
        if failure:
            raise _failed(failure)
    return [unpacked_block(done[task.name].value) for task in tasks]


def _entries(task: SampleTask) -> dict[str, Any]:
    entries = {key: value for key, value in vars(task).items() if value is not None}
    entries["observe"], entries["histograms"] = dict(task.observe), {}
    entries["at"] = list(task.at)
    if task.coordinate is None:
        del entries["at"]
    return entries


def _sent(order: Order) -> dict[str, Any]:
    start = None if order.start is None else packed_checkpoint(order.start)
    return {"number": order.number, "level": order.level, "start": start}


def _failed(failure: str) -> Exception:
    kind, _, text = failure.partition(": ")
    kinds = {"DivergedError": DivergedError, "SceneError": SceneError}
    return kinds[kind](text.rpartition(" (")[0]) if kind in kinds else DataError(failure)


def _ensemble(asked: Asked, say: Say, where: Where) -> dict[str, Any]:
    blocks = blocks_of(asked.plan.chains)
    done = _done(asked, [Order(i) for i in range(len(blocks))], where)
    if where.checkpoint is not None:
        write_checkpoint(where.checkpoint, [one.end for one in done])
    values = np.concatenate([one.values for one in done], axis=1)
    accepted = np.concatenate([one.accepted for one in done])
    names, units = (list(column) for column in zip(*asked.columns, strict=True))
    averages = {name: average(x) for name, x in zip(names, values, strict=True)}
    if asked.plan.method == "metropolis":
        say(f"accepted {accepted.mean():.3f}, dt {done[0].end.dt:.4g}")
    for line in _average_lines(averages, units, asked):
        say(line)
    found = {
        MAIN: sample_table(values, names, units),
        AVERAGES: average_table(averages, units),
        CHAINS: chain_table(accepted),
    }
    by_name = dict(zip(names, units, strict=True))
    for name, x, edges in _binned(asked, names, values):
        table = histogram_table(histogram(x, edges), by_name[name])
        found[HISTOGRAM + name] = table
    return found


def _done(asked: Asked, orders: Sequence[Order], where: Where) -> list[Sampled]:
    if where.goes_on is not None:
        size, blocks = asked.sampled.space.size, blocks_of(asked.plan.chains)
        sizes = [(size, one.stop - one.start) for one in blocks]
        starts = read_checkpoint(where.goes_on, sizes)
        orders = [order._replace(start=starts[order.number]) for order in orders]
    return blocks_done(asked, orders, where.workers, where.scheduler)


def _average_lines(
    averages: Mapping[str, Average], units: Sequence[str], asked: Asked
) -> Iterator[str]:
    sampled = asked.sampled
    degrees = degrees_of_freedom(sampled.space, sampled.start)
    for (name, one), unit in zip(averages.items(), units, strict=True):
        word = f" {unit}" if unit else ""
        yield (
            f"  {name}: {one.mean:.6g} +- {one.error:.2g}{word}, "
            f"{one.effective:.0f} effective samples, split R-hat {one.rhat:.4f}"
        )
        if name.startswith("energy.kinetic") and degrees:
            share = 2.0 / (degrees * asked.kT)
            yield f"    {share * one.mean:.6g} +- {share * one.error:.2g} of the temperature"
    apart = [n for n, one in averages.items() if one.rhat > _APART or one.effective < _FEW]
    if apart:
        yield (
            f"chains do not agree on {', '.join(apart[:4])}: they have not been long enough, or "
            "are in parts that do not meet"
        )


def chain_table(accepted: Array) -> Table:
    """Chains, a row each."""
    return Table([Column("chain", np.arange(1, len(accepted) + 1)), Column("accepted", accepted)])


def _binned(
    asked: Asked, names: Sequence[str], values: Array
) -> Iterator[tuple[str, Array, Array]]:
    """Name, values and edges of each histogram that is asked for, or of each quantity."""
    by_name, given = dict(zip(names, values, strict=True)), asked.task.histograms
    for name, (low, high, count) in given.items():
        if name not in by_name:
            raise SceneError(
                f"{asked.where}.histograms: there is no {name}, accepted: {', '.join(names)}"
            )
        yield name, by_name[name], np.linspace(low, high, int(count) + 1)
    for one in asked.quantities:
        x = by_name[one.name]
        if not given and np.ptp(x) > 0.0:
            yield one.name, x, np.linspace(float(x.min()), float(x.max()), _BINS + 1)


def sample_to(
    scene: Any,
    task: Path | None,
    changed: Mapping[str, Any],
    out: Path | None,
    plot: Path | None,
    say: Say,
    where: Where,
) -> None:
    """Sample an ensemble, and write it where a place is given.

    Args:
        task: Task file; None for entries alone.
        changed: Entries of the section `sample` that replace those of the file.
        out: Where samples go; its suffix chooses the format.
        plot: Where a picture goes.
        say: Is told what was found, a line each.
        where: Where chains are sampled.

    Raises:
        MbdError: Input that cannot be used, or a place that cannot be written to.
    """
    for place in filter(None, (out, plot, where.checkpoint)):
        refuse_overwriting(place, task, scene.path)
        check_place(place)
    if plot is not None and suffix_of(plot) not in PICTURES:
        raise SceneError(f"--plot {plot}: accepted are {', '.join(PICTURES)}")
    if out is not None:
        format_of(out)
    entries, name = _entries_of(scene, task), "sample" if task is None else f"{task}: sample"
    asked = Asked(scene, sample_task({**entries, **changed}, name), name)
    result = run_sample(asked, say, where)
    if out is not None:
        write_tables(result, out, say)
    if plot is not None:
        from mbd_ros.features.sampling.pictures import picture_of
        from mbd_ros.files.plot import save

        save(picture_of(result), plot)
        say(f"picture -> {plot}")


def _entries_of(scene: Any, task: Path | None) -> dict[str, Any]:
    if task is None:
        return {}
    entries = read_task(task, scene).entries
    if "sample" not in entries:
        raise SceneError(f"{task}: has no section sample")
    return dict(entries["sample"])


def task_of(scene: Any, task: str | Path | Mapping[str, Any]) -> tuple[SampleTask, str]:
    """The task of a file or of keys, and its name for messages."""
    if not isinstance(task, str | Path):
        return sample_task(dict(task), "sample"), "sample"
    parts = read_task(task, scene).parts
    if "sample" not in parts:
        raise SceneError(f"{task}: has no section sample")
    return parts["sample"], f"{task}: sample"


def sample_table(values: Array, names: Sequence[str], units: Sequence[str]) -> Table:
    """All samples, chain by chain.

    Args:
        values: Shape (quantities, chains, samples).
    """
    _, chains, samples = values.shape
    columns = [
        Column("chain", np.repeat(np.arange(1, chains + 1), samples)),
        Column("sample", np.tile(np.arange(1, samples + 1), chains)),
    ]
    pairs = zip(names, units, values, strict=True)
    return Table([*columns, *(Column(n, v.ravel(), unit) for n, unit, v in pairs)])


def average_table(found: Mapping[str, Average], units: Sequence[str]) -> Table:
    """Averages in one row: `<quantity>.mean`, `.standard_error`, .."""
    columns = []
    for (name, one), unit in zip(found.items(), units, strict=True):
        for value, (word, has_unit) in zip(one, _AVERAGE, strict=True):
            columns.append(Column(f"{name}.{word}", np.array([value]), unit if has_unit else ""))
    return Table(columns)


def histogram_table(found: Histogram, unit: str) -> Table:
    """Shares of samples, a row a bin."""
    return Table(
        [
            Column("low", found.edges[:-1], unit),
            Column("high", found.edges[1:], unit),
            Column("share", found.shares),
            Column("standard_error", found.errors),
        ]
    )


def profile_table(
    name: str, units: tuple[str, str], forces: Sequence[MeanForce], profile: Profile
) -> Table:
    """Mean force and free energy, a row a value of the coordinate.

    Args:
        name: Of the coordinate.
        units: Of the coordinate and of energies.
        forces: At its values.
        profile: Free energy there.
    """
    slope = f"{units[1]}/({units[0]})" if units[0] else units[1]

    def of(kind: str, field: str) -> Array:
        return np.array([getattr(getattr(one, kind), field) for one in forces])

    return Table(
        [
            Column(name, np.array([one.level for one in forces]), units[0]),
            Column("mean_force", of("force", "mean"), slope),
            Column("mean_force.standard_error", of("force", "error"), slope),
            Column("effective_samples", of("force", "effective")),
            Column("split_rhat", of("force", "rhat")),
            Column("multiplier", of("multiplier", "mean"), slope),
            Column("multiplier.standard_error", of("multiplier", "error"), slope),
            Column("free_energy", profile.energy, units[1]),
            Column("free_energy.standard_error", profile.errors, units[1]),
        ]
    )


def do(sent: Mapping[str, Any]) -> dict[str, Any]:
    """A block of chains in a worker."""
    asked = Asked(load_any(sent["scene"]), sample_task(sent["task"], "sample"), "sample")
    start = None if sent["start"] is None else unpacked_checkpoint(sent["start"])
    return packed_block(asked.done(Order(sent["number"], sent["level"], start)))
