"""Ensembles of a scene: `mbd-ros sample`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, DivergedError, SceneError
from mbd_ros.features.sampling.chains import (
    BlockOrder,
    SampledBlock,
    SamplingProblem,
    blocks_of,
    pack_block,
    pack_checkpoint,
    read_checkpoint,
    unpack_block,
    unpack_checkpoint,
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
    paths = (None if path is None else Path(path) for path in (goes_on, checkpoint))
    where = Where(workers, scheduler, *paths)
    with watching(progress):
        result = run_sample(
            SamplingProblem(scene, *task_of(scene, task)), say or remarks.append, where
        )
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def run_sample(problem: SamplingProblem, say: Say, where: Where = _HERE) -> Result:
    """Return the result of `sample` for a problem."""
    for line in _first_lines(problem):
        say(line)
    if problem.coordinate is not None:
        tables = _profile(problem, say, where)
    else:
        tables = _ensemble(problem, say, where)
    inputs = {
        "seed": problem.plan.seed,
        "thermal_energy": problem.kT,
        "method": problem.plan.method,
    }
    return Result(tables, metadata_of("sample", problem.scene, inputs, {}))


def _first_lines(problem: SamplingProblem) -> Iterator[str]:
    sampled, task = problem.sampled, problem.task
    degrees = degrees_of_freedom(sampled.space, sampled.start)
    yield (
        f"{sampled.name}: {sampled.space.size} coordinates, {degrees} degrees of freedom, "
        f"kT {problem.kT:.6g} {sampled.energy}, {task.method}"
        + (", Fixman's potential" if task.fixman else "")
    )
    is_wanted = sampled.is_small if task.components is None else task.components
    if not is_wanted or problem.coordinate is not None or not sampled.features:
        return
    parts = components(problem.ensemble(None), sampled.start, sampled.features, task.seed)
    if parts.number == 1:
        yield f"components: 1, from {len(parts.of_probe) - 1} random starts"
        return
    inside = int(np.count_nonzero(parts.of_probe == 0)) - 1
    yield (
        f"components: {parts.number} that no motion along the constraints joins; "
        f"{inside} of {len(parts.of_probe) - 1} random starts are in that of the scene"
    )
    yield from (f"  wall: {wall}" for wall in parts.walls)


def _profile(problem: SamplingProblem, say: Say, where: Where) -> dict[str, Any]:
    if where.goes_on is not None or where.checkpoint is not None:
        raise SceneError("mean forces have no checkpoints; leave out checkpoint and continue")
    levels, blocks = list(problem.task.at), blocks_of(problem.plan.chains)
    orders = [BlockOrder(i, level) for level in levels for i in range(len(blocks))]
    done = sample_blocks(problem, orders, where.workers, where.scheduler)
    forces = []
    for k, level in enumerate(levels):
        mine = done[k * len(blocks) : (k + 1) * len(blocks)]
        values = np.concatenate([level_mean.values for level_mean in mine], axis=1)
        forces.append(mean_force(level, *values))
    profile, coordinate = free_energy(forces), problem.coordinate
    assert coordinate is not None
    units = (coordinate.unit, problem.sampled.energy)
    for level_mean, energy, error in zip(forces, *profile, strict=True):
        say(
            f"  {coordinate.name} {level_mean.level:g}: mean force {level_mean.force.mean:.6g} +- "
            f"{level_mean.force.error:.2g}, free energy {energy:.6g} +- {error:.2g} "
            f"({level_mean.force.effective:.0f} effective samples)"
        )
    table = profile_table(coordinate.name, units, forces, profile)
    return {MAIN: table, PROFILE: table}


def sample_blocks(
    problem: SamplingProblem,
    orders: Sequence[BlockOrder],
    workers: int | None,
    scheduler: str | None,
) -> list[SampledBlock]:
    """Sample blocks of chains, here or in workers, and return them in the order of `orders`.

    Raises:
        DataError: A worker has failed.
        MbdError: A step does not end on the constraints, or a value of the coordinate cannot be
            reached.
    """
    scene = problem.scene
    alone = scene.path is None or getattr(scene, "code", False) or len(orders) < 2
    if alone or (workers == 1 and scheduler is None):
        return [problem.sample_block(order) for order in orders]
    entries = _entries(problem.task)
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
    return [unpack_block(done[task.name].value) for task in tasks]


def _entries(task: SampleTask) -> dict[str, Any]:
    entries = {key: value for key, value in vars(task).items() if value is not None}
    entries["observe"], entries["histograms"] = dict(task.observe), {}
    entries["at"] = list(task.at)
    if task.coordinate is None:
        del entries["at"]
    return entries


def _sent(order: BlockOrder) -> dict[str, Any]:
    start = None if order.start is None else pack_checkpoint(order.start)
    return {"number": order.number, "level": order.level, "start": start}


def _failed(failure: str) -> Exception:
    kind, _, text = failure.partition(": ")
    kinds = {"DivergedError": DivergedError, "SceneError": SceneError}
    return kinds[kind](text.rpartition(" (")[0]) if kind in kinds else DataError(failure)


def _ensemble(problem: SamplingProblem, say: Say, where: Where) -> dict[str, Any]:
    blocks = blocks_of(problem.plan.chains)
    blocks_of_run = _sample(problem, [BlockOrder(i) for i in range(len(blocks))], where)
    if where.checkpoint is not None:
        write_checkpoint(where.checkpoint, [block.end for block in blocks_of_run])
    values = np.concatenate([block.values for block in blocks_of_run], axis=1)
    accepted = np.concatenate([block.accepted for block in blocks_of_run])
    names, units = (list(column) for column in zip(*problem.columns, strict=True))
    averages = {name: average(x) for name, x in zip(names, values, strict=True)}
    if problem.plan.method == "metropolis":
        say(f"accepted {accepted.mean():.3f}, dt {blocks_of_run[0].end.dt:.4g}")
    for line in _average_lines(averages, units, problem):
        say(line)
    tables = {
        MAIN: sample_table(values, names, units),
        AVERAGES: average_table(averages, units),
        CHAINS: chain_table(accepted),
    }
    by_name = dict(zip(names, units, strict=True))
    for name, x, edges in _binned(problem, names, values):
        table = histogram_table(histogram(x, edges), by_name[name])
        tables[HISTOGRAM + name] = table
    return tables


def _sample(
    problem: SamplingProblem, orders: Sequence[BlockOrder], where: Where
) -> list[SampledBlock]:
    if where.goes_on is not None:
        size, blocks = problem.sampled.space.size, blocks_of(problem.plan.chains)
        sizes = [(size, one.stop - one.start) for one in blocks]
        starts = read_checkpoint(where.goes_on, sizes)
        orders = [order._replace(start=starts[order.number]) for order in orders]
    return sample_blocks(problem, orders, where.workers, where.scheduler)


def _average_lines(
    averages: Mapping[str, Average], units: Sequence[str], problem: SamplingProblem
) -> Iterator[str]:
    sampled = problem.sampled
    degrees = degrees_of_freedom(sampled.space, sampled.start)
    for (name, estimate), unit in zip(averages.items(), units, strict=True):
        word = f" {unit}" if unit else ""
        yield (
            f"  {name}: {estimate.mean:.6g} +- {estimate.error:.2g}{word}, "
            f"{estimate.effective:.0f} effective samples, split R-hat {estimate.rhat:.4f}"
        )
        if name.startswith("energy.kinetic") and degrees:
            share = 2.0 / (degrees * problem.kT)
            mean, error = share * estimate.mean, share * estimate.error
            yield f"    {mean:.6g} +- {error:.2g} of the temperature"
    apart = [
        n
        for n, estimate in averages.items()
        if estimate.rhat > _APART or estimate.effective < _FEW
    ]
    if apart:
        yield (
            f"chains do not agree on {', '.join(apart[:4])}: they are too short, or in components "
            "that are not connected"
        )


def chain_table(accepted: Array) -> Table:
    """Return one row per chain."""
    return Table([Column("chain", np.arange(1, len(accepted) + 1)), Column("accepted", accepted)])


def _binned(
    problem: SamplingProblem, names: Sequence[str], values: Array
) -> Iterator[tuple[str, Array, Array]]:
    """Yield name, values and edges of the histograms of the task, or of all quantities."""
    by_name, histograms = dict(zip(names, values, strict=True)), problem.task.histograms
    for name, (low, high, count) in histograms.items():
        if name not in by_name:
            raise SceneError(
                f"{problem.where}.histograms: unknown {name}, accepted: {', '.join(names)}"
            )
        yield name, by_name[name], np.linspace(low, high, int(count) + 1)
    for quantity in problem.quantities:
        x = by_name[quantity.name]
        if not histograms and np.ptp(x) > 0.0:
            yield quantity.name, x, np.linspace(float(x.min()), float(x.max()), _BINS + 1)


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
    problem = SamplingProblem(scene, sample_task({**entries, **changed}, name), name)
    result = run_sample(problem, say, where)
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
        raise SceneError(f"{task}: has no section 'sample'")
    return dict(entries["sample"])


def task_of(scene: Any, task: str | Path | Mapping[str, Any]) -> tuple[SampleTask, str]:
    """Return the task of a file or of keys, and its name for messages."""
    if not isinstance(task, str | Path):
        return sample_task(dict(task), "sample"), "sample"
    parts = read_task(task, scene).parts
    if "sample" not in parts:
        raise SceneError(f"{task}: has no section 'sample'")
    return parts["sample"], f"{task}: sample"


def sample_table(values: Array, names: Sequence[str], units: Sequence[str]) -> Table:
    """Return all samples, chain by chain.

    Args:
        values: Values of the quantities, shape (quantities, chains, samples).
    """
    _, chains, samples = values.shape
    columns = [
        Column("chain", np.repeat(np.arange(1, chains + 1), samples)),
        Column("sample", np.tile(np.arange(1, samples + 1), chains)),
    ]
    pairs = zip(names, units, values, strict=True)
    return Table([*columns, *(Column(n, v.ravel(), unit) for n, unit, v in pairs)])


def average_table(averages: Mapping[str, Average], units: Sequence[str]) -> Table:
    """Return the averages in one row: `<quantity>.mean`, `.standard_error` and so on."""
    columns = []
    for (name, one), unit in zip(averages.items(), units, strict=True):
        for value, (word, has_unit) in zip(one, _AVERAGE, strict=True):
            columns.append(Column(f"{name}.{word}", np.array([value]), unit if has_unit else ""))
    return Table(columns)


def histogram_table(histogram: Histogram, unit: str) -> Table:
    """Return the shares of samples, one row per bin."""
    return Table(
        [
            Column("low", histogram.edges[:-1], unit),
            Column("high", histogram.edges[1:], unit),
            Column("share", histogram.shares),
            Column("standard_error", histogram.errors),
        ]
    )


def profile_table(
    name: str, units: tuple[str, str], forces: Sequence[MeanForce], profile: Profile
) -> Table:
    """Return mean force and free energy, one row per value of the coordinate.

    Args:
        name: Name of the coordinate.
        units: Units of the coordinate and of energies.
        forces: Mean forces at its values.
        profile: Free energies at its values.
    """
    slope = f"{units[1]}/({units[0]})" if units[0] else units[1]

    def of(kind: str, field: str) -> Array:
        return np.array([getattr(getattr(level_force, kind), field) for level_force in forces])

    return Table(
        [
            Column(name, np.array([level_force.level for level_force in forces]), units[0]),
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
    """Sample a block of chains in a worker process."""
    problem = SamplingProblem(
        load_any(sent["scene"]), sample_task(sent["task"], "sample"), "sample"
    )
    start = None if sent["start"] is None else unpack_checkpoint(sent["start"])
    return pack_block(problem.sample_block(BlockOrder(sent["number"], sent["level"], start)))
