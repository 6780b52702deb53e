"""Files of learning: the folder of a model, and the tables and the picture of a comparison.

A folder holds the network (ONNX), its weights, from which learning goes on, and the scene that
loads it.
"""

import io
import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import yaml

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError, SceneError
from mbd_ros.features.identification.learn.comparison import WAYS, compare
from mbd_ros.features.identification.learn.job import run_learn
from mbd_ros.features.identification.learn.linear_corrections import Known
from mbd_ros.features.identification.learn.scales import Scales
from mbd_ros.features.identification.learn.task import Learned, Outcome, Task
from mbd_ros.features.identification.outcome import (
    csv,
    description_of,
    scene_text,
    write_files,
)
from mbd_ros.files.output_file import refuse_overwriting
from mbd_ros.files.table import Table
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.learned import about_of, check_robot
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

MODEL, WEIGHTS, SCENE = "model.onnx", "weights.npz", "scene.yaml"
_LARGEST = 256_000_000  # bytes of weights
_MARKS = ("s", "D", "o", "^", "v")


def learn_to(scene: Scene, task: Task, folder: Path, start: Path | None, say: Say) -> None:
    """Write a model into a folder; all files, or none."""
    _refuse(folder, task, start)
    if start is not None:
        model = read_folder(start)
        task, scene = task._replace(start=model), _as_identified(scene, start, model, say)
    write_folder(folder, run_learn(scene, task, say), {}, say)


def _refuse(folder: Path, task: Task, start: Path | None) -> None:
    sources: Sequence[object] = (*task.motions, *task.wrenches, start)
    refuse_overwriting(folder, *(source for source in sources if isinstance(source, Path)))


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


def write_folder(folder: Path, found: Outcome, more: Mapping[str, bytes], say: Say) -> None:
    """Write `model.onnx`, `weights.npz`, `scene.yaml` and tables; all, or none.

    Args:
        folder: Is made.
        found: What was learned.
        more: Other files by name.
        say: Is told the names.

    Raises:
        DataError: A place that cannot be written to.
    """
    files: dict[str, bytes] = {MODEL: found.content, WEIGHTS: _weights(found.model), **more}
    try:
        files["robot.urdf"] = description_of(found.scene).encode()
        files[SCENE] = _scene(found)
    except SceneError as error:
        say(f"no scene.yaml is written: {error}")
    for name, table in found.tables.items():
        files[f"{name}.csv"] = csv(table)
    write_files(folder, files, say)


def _weights(model: Learned) -> bytes:
    arrays = {f"weight.{key}": value for key, value in model.weights.items()}
    arrays |= {f"scale.{key}": value for key, value in model.scales._asdict().items()}
    arrays |= {f"known.{key}": value for key, value in model.known._asdict().items()}
    arrays |= {"trust": model.trust, "numbers": model.numbers}
    target = io.BytesIO()
    np.savez_compressed(target, about=np.array(model.about.text()), **arrays)
    return target.getvalue()


def _scene(found: Outcome) -> bytes:
    """The scene that the network stands on, with the network."""
    values: dict[str, Any] = yaml.safe_load(scene_text(found.scene, "robot.urdf"))
    forces = [*(values.get("forces") or []), {"type": "learned_torque", "model": MODEL}]
    text: str = yaml.safe_dump({**values, "forces": forces}, sort_keys=False, width=120)
    return text.encode()


def read_folder(folder: Path) -> Learned:
    """The model of a folder, to go on from; reading it runs no code.

    Raises:
        DataError: It is none, of another version, or damaged; names it.
    """
    path = folder / WEIGHTS
    try:
        if path.stat().st_size > _LARGEST:
            raise DataError(f"{path}: more than {_LARGEST} bytes")
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, EOFError, KeyError, BadZipFile) as error:
        raise DataError(f"{path}: is damaged, or no file of mbd-ros learn") from error
    return _learned(path, arrays)


def _learned(path: Path, arrays: dict[str, Array]) -> Learned:
    try:
        about = about_of(str(path), json.loads(str(arrays["about"])))
        scales = Scales(*(arrays[f"scale.{key}"] for key in Scales._fields))
        weights = {
            key.removeprefix("weight."): value
            for key, value in arrays.items()
            if key.startswith("weight.")
        }
        known = Known(*(arrays[f"known.{key}"] for key in Known._fields))
        return Learned(about, scales, weights, arrays["trust"], known, arrays["numbers"])
    except ModelError as error:
        raise DataError(str(error)) from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: is no file of mbd-ros learn: {error}") from error


def compare_to(scene: Scene, task: Task, folder: Path, seeds: int, say: Say) -> None:
    """Write `comparison.csv`, `runs.csv` and `comparison.png`; all, or none."""
    if not 1 <= seeds <= 100:
        raise DataError(f"--seeds {seeds}: accepted are 1 .. 100")
    _refuse(folder, task, None)
    runs, summary = compare(scene, task, range(task.seed, task.seed + seeds), say)
    files = {
        "comparison.csv": csv(summary),
        "runs.csv": csv(runs),
        "comparison.png": picture(summary),
    }
    write_files(folder, files, say)


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
