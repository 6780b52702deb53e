"""A predicted motion into files: `mbd-ros predict`."""

from pathlib import Path

from mbd_ros.features.prediction.failure import reasons
from mbd_ros.features.prediction.job import run_predict, task_of
from mbd_ros.features.prediction.starts import where_of
from mbd_ros.features.prediction.tables import CONTINUATION, GOALS, NODES, STARTS
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.jobs.lines import Say, say_all
from mbd_ros.jobs.result_files import beside, write_tables
from mbd_ros.scene.built_scene import Scene


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
        scene: The scene.
        task: Task file.
        out: The motion; its suffix chooses the format.
        say: Is told what was found, a line each.
        workers: How many processes try the starts of a task; None for one a core.
        scheduler: Of a Dask cluster, in place of them.

    Returns:
        Whether there is a solution.

    Raises:
        MbdError: As `predict`, or a place that cannot be written to.
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
