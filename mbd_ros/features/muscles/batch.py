"""Muscle forces of several motions, one each on a core or on a cluster."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbd_ros.errors import DataError
from mbd_ros.features.muscles.job import muscles_to
from mbd_ros.features.muscles.task import muscles_task
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.batch import Batch, Outcome, do_batch, do_one, task_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene


def muscles_batch(batch: Batch, task_file: Path | None, say: Say) -> None:
    """Do all motions.

    Args:
        batch: The motions; its options are keys of the section `muscles` of a task file.
        task_file: Its section `muscles` says what the options leave out.
        say: Is told what was done.
    """
    options = _options(batch.options, task_file, load_scene(batch.scene))
    do_batch(batch._replace(options=options), _muscles, one, say)


def one(argument: Mapping[str, Any]) -> Outcome:
    """One motion, in a worker."""
    return do_one(argument, _muscles)


def _muscles(batch: Batch, say: Say) -> None:
    scene = load_scene(batch.scene)
    asked = muscles_task(scene, batch.options, "muscles")
    muscles_to(scene, task_of(batch), asked, batch.options, batch.out, say)


def _options(given: Mapping[str, Any], task_file: Path | None, scene: Scene) -> dict[str, Any]:
    """Options of the command, and else of the task file; checked."""
    options: dict[str, Any] = {}
    if task_file is not None:
        from mbd_ros.scene.task_reader import read_task

        entry = read_task(task_file, scene).entries.get("muscles")
        if entry is None:
            raise DataError(f"--task {task_file}: has no section muscles")
        options = dict(entry)
        for key in ("emg", "reserves"):  # relative to the task file
            if isinstance(options.get(key), str):
                options[key] = str((task_file.parent / options[key]).absolute())
    options |= given
    muscles_task(scene, options, "muscles").solver(scene)
    return options
