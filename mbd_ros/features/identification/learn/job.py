"""Learning of what the equations of motion leave of measured torques: `mbd-ros learn`.

The folder of a model holds the network (ONNX), its weights, from which learning goes on, and the
scene that loads it.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, MbdError, ModelError, SceneError
from mbd_ros.features.identification.job import run_identify
from mbd_ros.features.identification.learn.fitting import (
    FEWEST,
    Recordings,
    fit,
    require_torch,
    share_of,
)
from mbd_ros.features.identification.learn.linear_corrections import Columns
from mbd_ros.features.identification.learn.onnx_file import onnx_of
from mbd_ros.features.identification.learn.task import FREEZE, Learned, Outcome, Task
from mbd_ros.features.identification.learn.training_samples import Samples
from mbd_ros.features.identification.learn.weights_file import (
    WEIGHTS,
    read_folder,
    weights_file,
)
from mbd_ros.features.identification.outcome import csv, description_of, scene_text
from mbd_ros.features.identification.samples import split
from mbd_ros.features.identification.task import Task as IdentifyTask
from mbd_ros.features.identification.task import keep_remarks
from mbd_ros.files.output_folder import write_files
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.files.text_file import refuse_overwriting
from mbd_ros.jobs.progress import Say, Watch, share_watch, watching
from mbd_ros.methods.learned import TrainingRange, check_robot, numbers_of
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.variants import with_sections

MODEL, SCENE = "model.onnx", "scene.yaml"


def learn(
    scene: Scene,
    *motions: Source,
    wrenches: Source | Sequence[Source] = (),
    say: Say | None = None,
    progress: Watch = False,
    **options: Any,
) -> Outcome:
    """What the equations of motion leave of measured torques, as a network beside them.

    Args:
        *motions: Results, files or bags with positions and efforts.
        wrenches: Of tables with external loads, one a motion.
        say: Is called with each line for people.
        progress: True for a line on a terminal, or a function of a label and a share.
        **options: Other attributes of `mbd_ros.features.identification.learn.task.Task`.

    Raises:
        DataError: Recordings that cannot be read or say nothing, with the reason; torch is not
            installed.
    """
    loads = [wrenches] if isinstance(wrenches, str | Path | Result) else list(wrenches)
    remarks, tell = keep_remarks(say)
    with watching(progress):
        return run_learn(scene, Task(motions, loads, **options), tell)._replace(remarks=remarks)


def run_learn(scene: Scene, task: Task, say: Say) -> Outcome:
    """Do the task of `learn`."""
    task.check()
    if task.freeze == FREEZE[1] and task.start is None:
        raise DataError(f"--freeze {FREEZE[1]}: needs the model that is adapted, --start DIR")
    require_torch()
    scene = without_model(scene)
    recordings = Recordings(scene, task, say)
    parts = [split(one, task.learned) for one in recordings.every]
    stands_on = physics_of(scene, task, say)
    samples = recordings.samples(stands_on, [first for first, _ in parts])
    rest = [one for _, one in parts if one is not None]
    with share_watch("learning") as tell:
        model = fit(stands_on, task, recordings.joints, samples, tell)
    if stands_on is not scene:
        model = model._replace(about=model.about._replace(given=numbers_of(scene.robot)))
    _say_what_acts(model, say)
    is_enough = sum(len(one.times) for one in rest) >= FEWEST
    test = recordings.samples(stands_on, rest) if is_enough else None
    errors, table = _validated(stands_on, model, test)
    if errors:
        say(
            "not learned from, efforts as measured: physics {physics:.2f} % of the torque, with "
            "what was learned {learned:.2f} %".format(**{k: 100 * e for k, e in errors.items()})
        )
    content = onnx_of(model.about, model.weights, model.scales, model.trust)
    return Outcome(model, content, stands_on, {"validation": table}, errors, [])


def _say_what_acts(model: Learned, say: Say) -> None:
    """Which joints have a network that gives something, and whether numbers are corrected."""
    if model.numbers.any():
        say("adapters: inertias, friction and stiffness are corrected")
        if not model.trust.any():
            say("the network adds nothing that holds to that; it gives 0")
            return
    for name, share in zip(model.about.joints, model.trust, strict=True):
        if share == 0.0:
            say(f"{name}: nothing was found that holds where it was not learned from; it gives 0")


def _validated(
    scene: Scene, model: Learned, test: Samples | None
) -> tuple[dict[str, float], Table]:
    """Errors of what was not learned from."""
    joints = Column("joint", np.array(list(model.about.joints)))
    if test is None:
        return {}, Table([joints])
    said = {"physics": test.physics, "learned": prediction(scene, model, test)}
    columns = [joints, Column("trust", model.trust)]
    for name, torque in said.items():
        rms = np.sqrt(np.mean(np.square(torque - test.measured), axis=0))
        columns.append(Column(f"{name}.rms", rms, "N·m or N"))
    return {name: share_of(torque, test.measured) for name, torque in said.items()}, Table(columns)


def without_model(scene: Scene) -> Scene:
    """The scene without a model that was learned before."""
    given = scene.entries.get("forces") or []
    kept = [entry for entry in given if entry.get("type") != "learned_torque"]
    return scene if len(kept) == len(given) else with_sections(scene, forces=kept)


def physics_of(scene: Scene, task: Task, say: Say) -> Scene:
    """The scene that the network stands on: identified from the same samples, or as given."""
    if task.physics == "given" or task.start is not None:
        return scene
    asked = IdentifyTask(
        task.motions,
        task.wrenches,
        task.topic,
        task.derivatives,
        task.band,
        learned=task.learned,
        partial=True,
    )
    try:
        description_of(scene)
        found = run_identify(scene, asked, lambda line: None)
    except MbdError as error:
        say(f"the scene stays as given: {error}")
        return scene
    say("the scene is identified first; the network stands on that")
    return found.scene


def prediction(scene: Scene, model: Learned, samples: Samples) -> Any:
    """Torque of the scene and of the model [N·m or N], shape (n, m)."""
    found = samples.physics + model.trust * _within_range(model, samples)
    if model.numbers.any():
        columns = Columns(scene, model.about.joints, model.scales)
        found += columns.torque(samples, model.numbers)
    return found


def _within_range(model: Learned, samples: Samples) -> Array:
    """Torque of the network as `LearnedTorque` lets it act, shape (n, m)."""
    from mbd_ros.features.identification.learn.network import network_of, said_by

    network, about, m = network_of(model.about.kind, model.scales), model.about, samples.q.shape[1]
    whole = TrainingRange(about.low, about.high).shares(np.hstack([samples.q, samples.v]))
    places = TrainingRange(about.low[:m], about.high[:m]).shares(samples.q)
    still = said_by(network, model.weights, samples._replace(a=np.zeros_like(samples.a)))
    inertial = said_by(network, model.weights, samples) - still
    return whole[:, None] * still + places[:, None] * inertial


def learn_to(scene: Scene, task: Task, folder: Path, start: Path | None, say: Say) -> None:
    """Write a model into a folder; all files, or none."""
    refuse_sources(folder, task, start)
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


def refuse_sources(folder: Path, task: Task, start: Path | None) -> None:
    """Refuse a folder for results that is read from."""
    sources: Sequence[object] = (*task.motions, *task.wrenches, start)
    refuse_overwriting(folder, *(source for source in sources if isinstance(source, Path)))


def write_folder(folder: Path, found: Outcome, more: Mapping[str, bytes], say: Say) -> None:
    """Write `model.onnx`, `weights.npz`, `scene.yaml` and tables; all, or none.

    Args:
        found: What was learned.
        more: Other files by name.
        say: Is told the names.

    Raises:
        DataError: A place that cannot be written to.
    """
    files: dict[str, bytes] = {MODEL: found.content, WEIGHTS: weights_file(found.model), **more}
    try:
        files["robot.urdf"] = description_of(found.scene).encode()
        files[SCENE] = _scene(found)
    except SceneError as error:
        say(f"no scene.yaml is written: {error}")
    for name, table in found.tables.items():
        files[f"{name}.csv"] = csv(table)
    write_files(folder, files)
    say(f"{folder}: {', '.join(files)}")


def _scene(found: Outcome) -> bytes:
    """The scene that the network stands on, with the network."""
    values: dict[str, Any] = yaml.safe_load(scene_text(found.scene, "robot.urdf"))
    forces = [*(values.get("forces") or []), {"type": "learned_torque", "model": MODEL}]
    text: str = yaml.safe_dump({**values, "forces": forces}, sort_keys=False, width=120)
    return text.encode()
