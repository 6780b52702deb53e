"""Ensembles into files: `mbd-ros sample`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbd_ros.errors import SceneError
from mbd_ros.features.sampling.chain_setup import Asked
from mbd_ros.features.sampling.job import Where, run_sample
from mbd_ros.features.sampling.task import sample_task
from mbd_ros.files.formats import PICTURES, format_of, suffix_of
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.result_files import write_tables
from mbd_ros.scene.task_reader import read_task


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
        scene: The scene.
        task: Task file; None for entries alone.
        changed: Entries of the section `sample` that replace those of the file.
        out: Where samples go; its suffix chooses the format.
        plot: Where a picture goes.
        say: Is told what was found, a line each.
        where: Where chains are sampled.

    Raises:
        MbdError: As `sample`, or a place that cannot be written to.
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
