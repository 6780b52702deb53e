"""Solvers of marker kinematics from a scene and a task."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError, SceneError
from mbd_ros.features.markers.kinematics_task import (
    CoordinateTask,
    KinematicsTask,
    refuse_unknown_joints,
)
from mbd_ros.features.markers.marker_kinematics import Mark, MarkerKinematics
from mbd_ros.features.markers.matching import markers_of, weights_of
from mbd_ros.files.times import TIME
from mbd_ros.motion.recordings import Source, name_of, read_columns
from mbd_ros.scene.built_scene import Scene

NO_TASK = KinematicsTask()
_SAME = 1.0e-6  # s by which a recorded motion may be shorter than the markers


def read_tasks(scene: Scene, task: KinematicsTask | str | Path) -> KinematicsTask:
    """The task of a file, by its ending, or as it is.

    Raises:
        SceneError: Names file, key or element, and what is accepted.
    """
    if isinstance(task, KinematicsTask):
        return task
    if str(task).lower().endswith((".xml", ".xml.gz")):
        from mbd_ros.features.markers.osim_setup import read_setup

        found = read_setup(Path(task))
        moving = {n: t for n, t in found.coordinates.items() if n not in scene.robot.locked}
        refuse_unknown_joints(scene, moving, str(task))
        return found
    from mbd_ros.scene.task_reader import read_task

    parts = read_task(task, scene).parts
    if "kinematics" not in parts:
        raise SceneError(f"{task}: no section 'kinematics'")
    asked: KinematicsTask = parts["kinematics"]
    return asked


def solver_of(
    scene: Scene, marks: Sequence[Mark], task: KinematicsTask, where: str
) -> MarkerKinematics:
    """The solver of a task.

    Raises:
        DataError: There is nothing to fit; names `where`.
    """
    weights = {name: one.weight for name, one in _tasks(scene, task).items() if one.weight}
    parts = scene.robot, scene.couplings, marks
    options = {"constraints": scene.constraints, "tasks": weights, "limits": task.limits}
    try:
        return MarkerKinematics(*parts, **options)
    except ModelError as error:
        raise DataError(f"{where}: {error}") from error


def live_solver(
    scene: Scene, task: str, *, limits: bool = True
) -> tuple[MarkerKinematics, dict[str, Array]]:
    """A solver for all markers of a scene, and the positions that coordinate tasks ask for.

    Args:
        scene: The scene.
        task: File of a task; empty for the weights of the scene.
        limits: Whether joints keep their limits; a task may say no, too.

    Raises:
        SceneError: A task that cannot be read, or that follows a recorded motion.
        DataError: The scene has no marker that weighs something.
    """
    asked = read_tasks(scene, task) if task else NO_TASK
    asked = replace(asked, limits=limits and asked.limits)
    following = [name for name, one in asked.coordinates.items() if one.from_motion]
    if following:
        raise SceneError(f"{task}: {following[0]} follows a recorded motion, which is not live")
    markers = markers_of(scene)
    weights = weights_of(markers, asked)
    marks = [Mark(m.title, m.point, weights[m.title]) for m in markers if weights[m.title] > 0.0]
    if not marks:
        raise DataError(f"{task or scene.name}: no marker of the scene weighs anything")
    solver = solver_of(scene, marks, asked, scene.name)
    return solver, targets_of(scene, asked, np.zeros(1))


def targets_of(scene: Scene, task: KinematicsTask, times: Array) -> dict[str, Array]:
    """Joint -> positions that its task asks for at some times.

    Raises:
        DataError: A recorded motion lacks the joint, or some of the times.
    """
    targets = {}
    for name, one in _tasks(scene, task).items():
        if one.from_motion and task.motion is not None:
            targets[name] = _recorded(task.motion, name, times)
        else:
            start = float(scene.initial.q[scene.robot.joint(name).q])
            targets[name] = np.full(len(times), start if one.value is None else one.value)
    return targets


def _tasks(scene: Scene, task: KinematicsTask) -> Mapping[str, CoordinateTask]:
    """Tasks of joints that move; a locked one stays where it is."""
    return {n: one for n, one in task.coordinates.items() if n not in scene.robot.locked}


def _recorded(motion: Source, name: str, times: Array) -> Array:
    column = f"{name}.position"
    columns = read_columns(motion, [TIME, column])
    if columns is None or np.isnan(columns[:, 1]).any():
        raise DataError(f"{name_of(motion)}: no column {column}, which a coordinate task follows")
    known = columns[:, 0]
    if times[0] < known[0] - _SAME or times[-1] > known[-1] + _SAME:
        raise DataError(
            f"{name_of(motion)}: has times {known[0]:g} .. {known[-1]:g} s, the markers "
            f"{times[0]:g} .. {times[-1]:g} s"
        )
    return np.array(np.interp(times, known, columns[:, 1]))
