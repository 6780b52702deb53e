"""Files of learning, and the picture of a comparison."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from mbd_ros.core.learned.model_file import check_robot
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.identification.identified_scene import write_files
from mbd_ros.features.identification.learn.comparison import WAYS, compare
from mbd_ros.features.identification.learn.job import run_learn
from mbd_ros.features.identification.learn.model_folder import (
    SCENE,
    csv,
    read_folder,
    write_folder,
)
from mbd_ros.features.identification.learn.task import Learned, Task
from mbd_ros.files.replacing import refuse_overwriting
from mbd_ros.files.table import Table
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

_MARKS = ("s", "D", "o", "^", "v")


def learn_to(scene: Scene, task: Task, folder: Path, start: Path | None, say: Say) -> None:
    """Write a model into a folder; all files, or none.

    Raises:
        MbdError: As `learn`, or a place that cannot be written to.
    """
    _refuse(folder, task, start)
    if start is not None:
        model = read_folder(start)
        task, scene = task._replace(start=model), _as_identified(scene, start, model, say)
    write_folder(folder, run_learn(scene, task, say), {}, say)


def _as_identified(scene: Scene, folder: Path, model: Learned, say: Say) -> Scene:
    """The scene that a model stands on, where this one is what it was identified from."""
    said = model.about
    if not said.given:
        return scene
    try:
        check_robot(str(folder), said._replace(robot=said.given), scene.robot)
    except ModelError:
        return scene
    say(f"{scene.name} as it was identified: {folder / SCENE}")
    return load_scene(folder / SCENE)


def compare_to(scene: Scene, task: Task, folder: Path, seeds: int, say: Say) -> None:
    """Write `comparison.csv`, `runs.csv` and `comparison.png`; all, or none.

    Raises:
        MbdError: As `compare`, or a place that cannot be written to.
    """
    if not 1 <= seeds <= 100:
        raise DataError(f"--seeds {seeds}: accepted are 1 .. 100")
    _refuse(folder, task, None)
    found = compare(scene, task, range(task.seed, task.seed + seeds), say)
    files = {
        "comparison.csv": csv(found.summary.columns),
        "runs.csv": csv(found.table.columns),
        "comparison.png": picture(found.summary),
    }
    write_files(folder, files, say)


def _refuse(folder: Path, task: Task, start: Path | None) -> None:
    sources: Sequence[object] = (*task.motions, *task.wrenches, start)
    refuse_overwriting(folder, *(source for source in sources if isinstance(source, Path)))


def picture(summary: Table) -> bytes:
    """Error over seconds of each way, the seeds as bars."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for way, mark in zip(WAYS, _MARKS, strict=True):
        own = summary["way"] == way
        mean, least, most = (summary[name][own] for name in ("mean", "least", "largest"))
        bars = (mean - least, most - mean)
        axes.errorbar(summary["seconds"][own], mean, bars, marker=mark, capsize=3, label=way)
    axes.set(xscale="log", yscale="log", xlabel="learned from [s]")
    axes.set_ylabel("error on what comes last [% of the torque]")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    target = BytesIO()
    figure.savefig(target, format="png", dpi=110)
    return target.getvalue()
