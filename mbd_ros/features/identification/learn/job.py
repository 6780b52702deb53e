"""Learning of the torques that the equations of motion do not explain: `mbd-ros learn`.

The folder of a model contains the network (ONNX), its weights, from which training can resume, and
the scene that uses it.
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
    relative_error,
    require_torch,
)
from mbd_ros.features.identification.learn.linear_corrections import Columns
from mbd_ros.features.identification.learn.onnx_file import onnx_bytes
from mbd_ros.features.identification.learn.task import FREEZE, LearnedModel, Outcome, Task
from mbd_ros.features.identification.learn.training_samples import Samples
from mbd_ros.features.identification.learn.weights_file import (
    WEIGHTS,
    read_folder,
    weights_file,
)
from mbd_ros.features.identification.outcome import csv_bytes, description_of, scene_text
from mbd_ros.features.identification.samples import split_recording
from mbd_ros.features.identification.task import Task as IdentifyTask
from mbd_ros.features.identification.task import keep_remarks
from mbd_ros.files.output_folder import write_files
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.files.text_file import refuse_overwriting
from mbd_ros.jobs.progress import Say, Watch, share_watch, watching
from mbd_ros.methods.learned_model import TrainingRange, check_robot, numbers_of
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
    """Train a network for the difference between measured efforts and the torques of a scene.

    Args:
        *motions: Results, files or bags with positions and efforts.
        wrenches: Tables with external loads, one per motion.
        say: Function that is called with each line for people.
        progress: True for a progress line on a terminal, or a function of a label and a share.
        **options: Other attributes of `mbd_ros.features.identification.learn.task.Task`.

    Raises:
        DataError: A recording cannot be read or does not suffice, or torch is not installed.
    """
    loads = [wrenches] if isinstance(wrenches, str | Path | Result) else list(wrenches)
    remarks, tell = keep_remarks(say)
    with watching(progress):
        return run_learn(scene, Task(motions, loads, **options), tell)._replace(remarks=remarks)


def run_learn(scene: Scene, task: Task, say: Say) -> Outcome:
    """Learn as a task says."""
    task.check()
    if task.freeze == FREEZE[1] and task.start is None:
        raise DataError(f"--freeze {FREEZE[1]}: give the model that is adapted, --start DIR")
    require_torch()
    scene = without_model(scene)
    recordings = Recordings(scene, task, say)
    parts = [split_recording(recorded, task.learned) for recorded in recordings.every]
    base = base_scene(scene, task, say)
    samples = recordings.samples(base, [first for first, _ in parts])
    tests = [second for _, second in parts if second is not None]
    with share_watch("learning") as tell:
        model = fit(base, task, recordings.joints, samples, tell)
    if base is not scene:
        model = model._replace(about=model.about._replace(given=numbers_of(scene.robot)))
    _report_model(model, say)
    is_enough = sum(len(recorded.times) for recorded in tests) >= FEWEST
    test = recordings.samples(base, tests) if is_enough else None
    errors, table = _validate(base, model, test)
    if errors:
        say(
            "error on data that were not used for training: scene {physics:.2f} % of the measured "
            "torque, with the learned model {learned:.2f} %".format(
                **{key: 100 * error for key, error in errors.items()}
            )
        )
    content = onnx_bytes(model.about, model.weights, model.scales, model.trust)
    return Outcome(model, content, base, {"validation": table}, errors, [])


def _report_model(model: LearnedModel, say: Say) -> None:
    """Tell which joints use the network, and whether corrections are used."""
    if model.numbers.any():
        say("adapters: inertias, friction and stiffness are corrected")
        if not model.trust.any():
            say("the network does not improve on these corrections, so its torque is 0")
            return
    for name, share in zip(model.about.joints, model.trust, strict=True):
        if share == 0.0:
            say(f"{name}: the network does not generalize to unseen data, so its torque is 0")


def _validate(
    scene: Scene, model: LearnedModel, test: Samples | None
) -> tuple[dict[str, float], Table]:
    """Return relative errors on the test samples, and a table of errors per joint."""
    joints = Column("joint", np.array(list(model.about.joints)))
    if test is None:
        return {}, Table([joints])
    torques = {"physics": test.physics, "learned": prediction(scene, model, test)}
    columns = [joints, Column("trust", model.trust)]
    for name, torque in torques.items():
        rms = np.sqrt(np.mean(np.square(torque - test.measured), axis=0))
        columns.append(Column(f"{name}.rms", rms, "N·m or N"))
    errors = {name: relative_error(torque, test.measured) for name, torque in torques.items()}
    return errors, Table(columns)


def without_model(scene: Scene) -> Scene:
    """Return the scene without learned models."""
    forces = scene.entries.get("forces") or []
    others = [entry for entry in forces if entry.get("type") != "learned_torque"]
    return scene if len(others) == len(forces) else with_sections(scene, forces=others)


def base_scene(scene: Scene, task: Task, say: Say) -> Scene:
    """Return the scene that the network corrects: identified from the same samples, or given."""
    if task.physics == "given" or task.start is not None:
        return scene
    identify_task = IdentifyTask(
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
        result = run_identify(scene, identify_task, lambda line: None)
    except MbdError as error:
        say(f"the scene was not identified and remains as given: {error}")
        return scene
    say("the scene was identified first; the network corrects the identified scene")
    return result.scene


def prediction(scene: Scene, model: LearnedModel, samples: Samples) -> Array:
    """Return the torque of the scene with the model [N·m or N], shape (n, m)."""
    torque = samples.physics + model.trust * _network_torque(model, samples)
    if model.numbers.any():
        columns = Columns(scene, model.about.joints, model.scales)
        torque += columns.torque(samples, model.numbers)
    return torque


def _network_torque(model: LearnedModel, samples: Samples) -> Array:
    """Return the torque of the network as `LearnedTorque` applies it, shape (n, m)."""
    from mbd_ros.features.identification.learn.network import make_network, mean_torque

    network, about, m = (
        make_network(model.about.kind, model.scales),
        model.about,
        samples.q.shape[1],
    )
    states = TrainingRange(about.low, about.high).shares(np.hstack([samples.q, samples.v]))
    positions = TrainingRange(about.low[:m], about.high[:m]).shares(samples.q)
    still = mean_torque(network, model.weights, samples._replace(a=np.zeros_like(samples.a)))
    inertial = mean_torque(network, model.weights, samples) - still
    return states[:, None] * still + positions[:, None] * inertial


def learn_to(scene: Scene, task: Task, folder: Path, start: Path | None, say: Say) -> None:
    """Learn and write the model into a folder; if anything fails, no file is written."""
    refuse_sources(folder, task, start)
    if start is not None:
        model = read_folder(start)
        task, scene = task._replace(start=model), _identified_scene(scene, start, model, say)
    write_folder(folder, run_learn(scene, task, say), {}, say)


def _identified_scene(scene: Scene, folder: Path, model: LearnedModel, say: Say) -> Scene:
    """Return the identified scene of a model if the given scene is what it was identified from."""
    about = model.about
    if not about.given:
        return scene
    try:
        check_robot(str(folder), about._replace(robot=about.given), scene.robot)
    except ModelError:
        return scene
    say(f"using the identified form of {scene.name}: {folder / SCENE}")
    return load_scene(folder / SCENE)


def refuse_sources(folder: Path, task: Task, start: Path | None) -> None:
    """Refuse a folder for results that contains a source."""
    sources: Sequence[object] = (*task.motions, *task.wrenches, start)
    refuse_overwriting(folder, *(source for source in sources if isinstance(source, Path)))


def write_folder(folder: Path, outcome: Outcome, more: Mapping[str, bytes], say: Say) -> None:
    """Write `model.onnx`, `weights.npz`, `scene.yaml` and tables; all of them, or none.

    Args:
        outcome: Result of learning.
        more: Other files by name.
        say: Receives a line with the names.

    Raises:
        DataError: The folder cannot be written to.
    """
    files: dict[str, bytes] = {
        MODEL: outcome.content,
        WEIGHTS: weights_file(outcome.model),
        **more,
    }
    try:
        files["robot.urdf"] = description_of(outcome.scene).encode()
        files[SCENE] = _scene_text(outcome)
    except SceneError as error:
        say(f"scene.yaml is not written: {error}")
    for name, table in outcome.tables.items():
        files[f"{name}.csv"] = csv_bytes(table)
    write_files(folder, files)
    say(f"{folder}: {', '.join(files)}")


def _scene_text(outcome: Outcome) -> bytes:
    """Return the YAML of the scene with the network."""
    values: dict[str, Any] = yaml.safe_load(scene_text(outcome.scene, "robot.urdf"))
    forces = [*(values.get("forces") or []), {"type": "learned_torque", "model": MODEL}]
    text: str = yaml.safe_dump({**values, "forces": forces}, sort_keys=False, width=120)
    return text.encode()
