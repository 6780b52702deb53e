"""A predicted motion into files: `mbd-ros predict`."""

from pathlib import Path

from mbd_ros.files.formats import format_of, suffix_of
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, Result
from mbd_ros.jobs.lines import Say, say_all
from mbd_ros.jobs.predict.failure import reasons
from mbd_ros.jobs.predict.job import run_predict, task_of
from mbd_ros.jobs.predict.tables import CONTINUATION, GOALS, NODES
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
        for place in (out, *(_beside(out, name) for name in (GOALS, NODES, CONTINUATION))):
            check_place(place)
    found, result = run_predict(scene, asked, say)
    if not found.is_converged:
        say_all(reasons(found, asked))
    if out is not None:
        _write(result, out, say)
    return found.is_converged


def _beside(out: Path, table: str) -> Path:
    suffix = suffix_of(out)
    return out.with_name(f"{out.name.removesuffix(suffix)}.{table}{suffix}")


def _write(result: Result, out: Path, say: Say) -> None:
    if not format_of(out).one_table:
        result.to(out)
        say(f"{', '.join(result)} -> {out}")
        return
    for name, table in result.tables.items():
        place = out if name == MAIN else _beside(out, name)
        Result({MAIN: table}, result.metadata).to(place)
        say(f"{name}, {table.rows} rows -> {place}")
