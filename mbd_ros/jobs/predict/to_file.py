"""A predicted motion into files: `mbd-ros predict`."""

from pathlib import Path

from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.jobs.lines import Say, say_all
from mbd_ros.jobs.predict.failure import reasons
from mbd_ros.jobs.predict.job import run_predict, task_of
from mbd_ros.jobs.predict.tables import CONTINUATION, GOALS, NODES
from mbd_ros.jobs.written import beside, write_tables
from mbd_ros.scene.built_scene import Scene


def predict_to(scene: Scene, task: Path, out: Path | None, say: Say) -> bool:
    """Find a motion, and write it where a place is given; the last iterate where there is none.

    Args:
        scene: The scene.
        task: Task file.
        out: The motion; its suffix chooses the format.
        say: Is told what was found, a line each.

    Returns:
        Whether there is a solution.

    Raises:
        MbdError: As `predict`, or a place that cannot be written to.
    """
    asked = task_of(scene, task)
    if out is not None:
        refuse_overwriting(out, task, scene.path)
        for place in (out, *(beside(out, name) for name in (GOALS, NODES, CONTINUATION))):
            check_place(place)
    found, result = run_predict(scene, asked, say)
    if not found.is_converged:
        say_all(reasons(found, asked))
    if out is not None:
        write_tables(result, out, say)
    return found.is_converged
