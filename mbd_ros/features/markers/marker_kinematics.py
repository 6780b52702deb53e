"""From places of markers to the motion of a robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Level
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError, SceneError
from mbd_ros.features.markers.kinematics_task import (
    CoordinateTask,
    KinematicsTask,
    refuse_unknown_joints,
)
from mbd_ros.features.markers.marker_cost import MarkerCost, Seen
from mbd_ros.features.markers.marker_fit import Bools, Fit, LoopRows, MarkerFit
from mbd_ros.features.markers.marker_trial import first_frame, fit_trial
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import TIME
from mbd_ros.methods.projection.coupled_joints import independent_limits
from mbd_ros.motion.recordings import Capture, read_columns
from mbd_ros.parts.sensors.marker import Marker
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.schema.nearest import nearest

_FARTHEST = 1.0e4  # m, of a place that a motion capture system can see
_NO_TASKS: Mapping[str, float] = {}
_LISTED = 8  # labels in a line
NO_TASK = KinematicsTask()
_SAME = 1.0e-6  # s by which a recorded motion may be shorter than the markers


class MarkerKinematics:
    """Fits the coordinates of a robot to markers.

    Joints that the markers and tasks leave open keep the values of the start.

    Args:
        couplings: Its dependent joints.
        constraints: Of the scene; rigid ones of positions are kept, others have no say.
        tasks: Joint -> weight of the square of its distance from a position that is asked for.
        limits: Whether the position limits of joints are kept, dependent ones included.

    Raises:
        ModelError: No marker and no task, or a task for a joint that there is not.
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        marks: Sequence[Mark],
        *,
        constraints: Sequence[Constraint] = (),
        tasks: Mapping[str, float] = _NO_TASKS,
        limits: bool = True,
    ) -> None:
        if not marks and not tasks:
            raise ModelError("marker kinematics needs a marker or a coordinate task")
        self.robot, self.marks, self.tasks = robot, tuple(marks), dict(tasks)
        self.labels = tuple(mark.label for mark in marks)
        self._weights = np.array([mark.weight for mark in marks])
        self._task_v = [robot.joint(name).v for name in tasks]
        weights = np.zeros(robot.model.nv)
        weights[self._task_v] = list(tasks.values())
        cost = MarkerCost(robot, couplings, [mark.point for mark in marks], weights)
        none = np.full(len(couplings.v_index), np.inf)
        lower, upper = independent_limits(robot, couplings) if limits else (-none, none)
        held = [part for part in rigid(constraints) if part.level is Level.POSITION]
        loops = LoopRows(robot, held, cost) if held else None
        self.solver = MarkerFit(cost, lower, upper, loops)

    def seen(
        self, places: Array, times: Array, targets: Mapping[str, Array] | None = None
    ) -> Seen:
        """Return measured markers as the solver takes them.

        Args:
            places: Positions of markers in the world [m], in the order of `marks`, shape
                (N, n, 3); NaN, or farther than 10 km, if a marker was not seen.
            times: Times of the frames [s], shape (N,).
            targets: Target positions of coordinate tasks by joint [rad or m], shape (N,); 0 for
                a task without any.
        """
        is_seen: Bools = np.array((np.abs(places) < _FARTHEST).all(axis=2))
        weights = np.where(is_seen, self._weights, 0.0)
        total = weights.sum(axis=1, keepdims=True)
        weights = weights / np.where(total > 0.0, total, 1.0)
        where = np.where(is_seen[:, :, None], places - self.robot.origin, 0.0)
        wanted = np.zeros((len(times), self.robot.model.nv))
        for name, v in zip(self.tasks, self._task_v, strict=True):
            wanted[:, v] = (targets or {}).get(name, 0.0)
        return Seen(where, weights, wanted, times)

    def trial(self, start: Array, seen: Seen) -> Fit:
        """Fit all frames of a trial, each from the solution of a neighbour.

        Args:
            start: Default configuration, shape (nq,).

        Raises:
            SolveError: Loops do not close near a start.
        """
        return fit_trial(self.solver, self.robot, start, seen)

    def first(self, start: Array, seen: Seen) -> Fit:
        """Fit one frame from several starts; arguments and errors are those of `trial`."""
        return first_frame(self.solver, self.robot, start, seen)


class Mark(NamedTuple):
    """A marker of the scene.

    Attributes:
        label: Label in recordings.
        point: Point on the robot.
        weight: Weight of the squared distance, > 0.
    """

    label: str
    point: Point
    weight: float


def live_solver(
    scene: Scene, task: str, *, limits: bool = True
) -> tuple[MarkerKinematics, dict[str, Array]]:
    """Return a solver for all markers of a scene, and the targets of coordinate tasks.

    Args:
        scene: The scene.
        task: Task file; empty for the weights of the scene.
        limits: Whether joints keep their limits, unless the task lets them pass.

    Raises:
        SceneError: The task cannot be read, or follows a recorded motion.
        DataError: The scene has no marker with a weight above 0.
    """
    order = read_tasks(scene, task) if task else NO_TASK
    order = replace(order, limits=limits and order.limits)
    following = [name for name, each in order.coordinates.items() if each.from_motion]
    if following:
        raise SceneError(f"{task}: {following[0]} follows a recorded motion, which is not live")
    markers = markers_of(scene)
    weights = weights_of(markers, order)
    marks = [Mark(m.title, m.point, weights[m.title]) for m in markers if weights[m.title] > 0.0]
    if not marks:
        raise DataError(f"{task or scene.name}: no marker of the scene has a weight above 0")
    solver = solver_of(scene, marks, order, scene.name)
    return solver, targets_of(scene, order, np.zeros(1))


def solver_of(
    scene: Scene, marks: Sequence[Mark], task: KinematicsTask, where: str
) -> MarkerKinematics:
    """Return the solver of a task.

    Raises:
        DataError: There is no marker and no coordinate task.
    """
    weights = {n: each.weight for n, each in _tasks(scene, task).items() if each.weight}
    parts = scene.robot, scene.couplings, marks
    options = {"constraints": scene.constraints, "tasks": weights, "limits": task.limits}
    try:
        return MarkerKinematics(*parts, **options)
    except ModelError as error:
        raise DataError(f"{where}: {error}") from error


def read_tasks(scene: Scene, task: KinematicsTask | str | Path) -> KinematicsTask:
    """Read a task file or a setup file of OpenSim; return a task as it is.

    Raises:
        SceneError: The file is not accepted; the message names file, key or element, and what is
            accepted.
    """
    if isinstance(task, KinematicsTask):
        return task
    if str(task).lower().endswith((".xml", ".xml.gz")):
        from mbd_ros.features.markers.osim_setup import read_setup

        setup = read_setup(Path(task))
        moving = {n: t for n, t in setup.coordinates.items() if n not in scene.robot.locked}
        refuse_unknown_joints(scene, moving, str(task))
        return setup
    from mbd_ros.scene.task_reader import read_task

    parts = read_task(task, scene).parts
    if "kinematics" not in parts:
        raise SceneError(f"{task}: has no section 'kinematics'")
    read: KinematicsTask = parts["kinematics"]
    return read


def targets_of(scene: Scene, task: KinematicsTask, times: Array) -> dict[str, Array]:
    """Joint -> positions that its task asks for at some times.

    Raises:
        DataError: A recorded motion lacks the joint, or some of the times.
    """
    targets = {}
    for name, coordinate_task in _tasks(scene, task).items():
        if coordinate_task.from_motion and task.motion is not None:
            targets[name] = _recorded(task.motion, name, times)
        else:
            start = float(scene.initial.q[scene.robot.joint(name).q])
            targets[name] = np.full(
                len(times), start if coordinate_task.value is None else coordinate_task.value
            )
    return targets


def _tasks(scene: Scene, task: KinematicsTask) -> Mapping[str, CoordinateTask]:
    """Tasks of joints that move; a locked one stays where it is."""
    return {n: one for n, one in task.coordinates.items() if n not in scene.robot.locked}


def _recorded(motion: Path, name: str, times: Array) -> Array:
    if is_bag(motion):
        raise DataError(f"{motion}: a coordinate task follows a column of a table, not a bag")
    column = f"{name}.position"
    columns = read_columns(motion, [TIME, column])
    if columns is None or np.isnan(columns[:, 1]).any():
        raise DataError(f"{motion}: no column {column}, which a coordinate task follows")
    known = columns[:, 0]
    if times[0] < known[0] - _SAME or times[-1] > known[-1] + _SAME:
        raise DataError(
            f"{motion}: has times {known[0]:g} .. {known[-1]:g} s, the markers "
            f"{times[0]:g} .. {times[-1]:g} s"
        )
    return np.array(np.interp(times, known, columns[:, 1]))


def match(scene: Scene, capture: Capture, task: KinematicsTask) -> Matched:
    """Find the markers of a scene in a recording, by label, else by name.

    Raises:
        DataError: The scene has no marker, labels that repeat, or none that the recording has.
    """
    markers = markers_of(scene)
    weights = weights_of(markers, task)
    column = {label: i for i, label in enumerate(capture.labels)}
    pairs = [(m, column.get(m.title, column.get(m.name))) for m in markers]
    used = [(m, at) for m, at in pairs if at is not None and weights[m.title] > 0.0]
    if not used and not any(one.weight for one in task.coordinates.values()):
        raise DataError(_nothing(markers, capture, task))
    marks = tuple(Mark(m.title, m.point, weights[m.title]) for m, _ in used)
    places = capture.places[:, [at for _, at in used]]
    mine = capture._replace(labels=tuple(mark.label for mark in marks), places=places)
    taken = {at for _, at in pairs if at is not None}
    lacking = [m.title for m, at in pairs if at is None and weights[m.title] > 0.0]
    others = [label for i, label in enumerate(capture.labels) if i not in taken]
    lines = [
        f"{len(marks)} markers of {len(markers)} in the scene, {len(capture.labels)} recorded"
    ]
    lines += _lines("not recorded", lacking, others)
    lines += _lines("recorded and not in the scene", others, lacking)
    lines += _lines("weights for no marker of the scene", _unknown(markers, task), lacking)
    return Matched(marks, mine, tuple(lines))


class Matched(NamedTuple):
    """Markers that the scene has and the recording too.

    Attributes:
        marks: Of the scene, those that weigh something.
        capture: Their places alone, in the same order.
        lines: For people: what was not used.
    """

    marks: tuple[Mark, ...]
    capture: Capture
    lines: tuple[str, ...]


def markers_of(scene: Scene) -> tuple[Marker, ...]:
    """The markers among the sensors of a scene.

    Raises:
        DataError: There is none, or two have one label.
    """
    markers = tuple(sensor for sensor in scene.sensors if isinstance(sensor, Marker))
    if not markers:
        raise DataError(f"{scene.name}: no markers: the scene needs sensors of type marker")
    counts = Counter(marker.title for marker in markers)
    repeated = [label for label, count in counts.items() if count > 1]
    if repeated:
        raise DataError(f"{scene.name}: two markers have the label {repeated[0]}")
    return markers


def weights_of(markers: Sequence[Marker], task: KinematicsTask) -> dict[str, float]:
    """Label -> weight: those of a task that names markers, else those of the scene."""
    if task.markers is None:
        return {marker.title: marker.weight for marker in markers}
    asked = task.markers
    return {m.title: asked.get(m.title, asked.get(m.name, 0.0)) for m in markers}


def _unknown(markers: Sequence[Marker], task: KinematicsTask) -> list[str]:
    known = {marker.title for marker in markers} | {marker.name for marker in markers}
    return [label for label in task.markers or {} if label not in known]


def _lines(what: str, labels: Sequence[str], others: Sequence[str]) -> Iterator[str]:
    if not labels:
        return
    more = f" and {len(labels) - _LISTED} more" if len(labels) > _LISTED else ""
    close = [(label, near[0]) for label in labels if (near := nearest(label, others, 1))]
    hint = f"; perhaps {', '.join(f'{a} is {b}' for a, b in close[:3])}" if close else ""
    yield f"{what}: {', '.join(labels[:_LISTED])}{more}{hint}"


def _nothing(markers: Sequence[Marker], capture: Capture, task: KinematicsTask) -> str:
    labels = [marker.title for marker in markers]
    near = [(label, close[0]) for label in capture.labels if (close := nearest(label, labels, 1))]
    hint = f"; the nearest: {', '.join(f'{a} to {b}' for a, b in near[:3])}" if near else ""
    weigh = "" if task.markers is None else " that weighs something in the task"
    return (
        f"{capture.where}: no recorded marker is one of the scene{weigh}; recorded are "
        f"{', '.join(capture.labels[:_LISTED])}, the scene has {', '.join(labels[:_LISTED])}{hint}"
    )
